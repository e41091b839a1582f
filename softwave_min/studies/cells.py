"""By which closed loops many parameter sets are judged: data/studies/headline_cells.toml."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as validated

from softwave_min.experiments import star
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import Count, ParameterSet, Positive, load_data
from softwave_min.studies.headlines import Cells


@validated(frozen=True, config=ConfigDict(extra="forbid"))
class _File:
    """What the file holds."""

    grid: tuple[tuple[str, Positive], ...]
    failure_poses: tuple[str, ...]
    failure_heights: tuple[Positive, ...]
    failed_segment: Count
    iterations: Count


def _file() -> _File:
    return load_data(_File, "studies/headline_cells.toml")


def headline_cells() -> Cells:
    """The cells of the file, in the paper's wave cases, and the nominal star."""
    file, targets, chosen = _file(), poses(), star.choice()
    return Cells(
        peak_periods=tuple((name, case.peak_period) for name, case in wave_cases().items()),
        grid=tuple((targets[pose], height) for pose, height in file.grid),
        failures=tuple(
            (targets[pose], height)
            for height, pose in product(file.failure_heights, file.failure_poses)
        ),
        failed_segment=file.failed_segment,
        star=chosen.path,
        star_height=chosen.significant_height,
    )


def with_bounded_solves(parameters: ParameterSet) -> ParameterSet:
    """The parameters with no more iterations of a solve than the file allows."""
    nmpc, most = parameters.nmpc, _file().iterations
    return replace(parameters, nmpc=replace(nmpc, max_iterations=min(most, nmpc.max_iterations)))
