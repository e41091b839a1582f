"""Places of the paper's grid: a wave case, a pose, a significant height and a random sea."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace

from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet


@dataclass(frozen=True)
class Place:
    """A pose in one random sea."""

    wave: str
    pose: str
    parameters: ParameterSet
    """In this sea, with its noise."""

    @property
    def height(self) -> float:
        """Significant height, in m."""
        return self.parameters.sea.significant_height

    @property
    def seed(self) -> int:
        """Seed of the sea."""
        return self.parameters.sea.seed

    @property
    def path(self) -> tuple[tuple[float, float], ...]:
        """Desired tip, in m: the pose, all the time."""
        return (poses()[self.pose],)

    @property
    def labels(self) -> dict[str, float | int | str]:
        """Leading columns of the place's row in a table."""
        return {"wave": self.wave, "pose": self.pose, "Hs": self.height, "seed": self.seed}

    def run_name(self, *marks: str) -> str:
        """Name of a run here, such as ``W1-P1-050cm-1``; ``marks`` tell several apart."""
        height = f"{100 * self.height:03.0f}cm"
        return "-".join([self.wave, self.pose, height, *marks, str(self.seed)])


def in_sea(parameters: ParameterSet, wave: str, significant_height: float) -> ParameterSet:
    """The parameters in one of the paper's wave cases, at a height in m."""
    period = wave_cases()[wave].peak_period
    sea = replace(parameters.sea, peak_period=period, significant_height=significant_height)
    return replace(parameters, sea=sea)


def realisations(parameters: ParameterSet) -> Iterator[ParameterSet]:
    """One parameter set for each random sea that is asked for, with its own noise."""
    for offset in range(parameters.sea.realisations):
        yield in_realisation(parameters, offset)


def in_realisation(parameters: ParameterSet, offset: int) -> ParameterSet:
    """The parameters in one sea and with one noise, counted from their own seeds."""
    sea = replace(parameters.sea, seed=parameters.sea.seed + offset, realisations=1)
    preview = replace(parameters.preview, seed=parameters.preview.seed + offset)
    return replace(parameters, sea=sea, preview=preview)


def at_least(parameters: ParameterSet, seas: int) -> ParameterSet:
    """The parameters with ``seas`` random seas, unless they ask for more than one themselves."""
    if parameters.sea.realisations > 1:
        return parameters
    return replace(parameters, sea=replace(parameters.sea, realisations=seas))


def places(
    parameters: ParameterSet,
    chosen_poses: Collection[str] | None = None,
    heights: Callable[[float], bool] = lambda _: True,
) -> Iterator[Place]:
    """The grid: wave, pose, height and random sea, the last changing fastest."""
    for wave, case in wave_cases().items():
        for pose in poses() if chosen_poses is None else chosen_poses:
            for height in filter(heights, case.significant_height):
                for one in realisations(in_sea(parameters, wave, height)):
                    yield Place(wave, pose, one)
