"""Controllers side by side: the same arm in the same sea, and how far each lets the tip stray."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import ArrayLike

from softwave_min.parameters import ParameterSet
from softwave_min.simulation.closed_loop import ClosedLoop, simulate
from softwave_min.simulation.controllers import CONTROLLERS, Controller, Factory
from softwave_min.simulation.scenario import Scenario
from softwave_min.waves import Sea

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes


class TipError(NamedTuple):
    """Root mean square errors of the tip in one run, in m."""

    whole: float
    """Over the whole run, start included."""
    settled: float
    """Without the first ``ClosedLoop.TRANSIENT`` seconds; NaN if there is no more."""


class Errors(Mapping[str, TipError]):
    """The tip's errors by the controller's name, which print as a table."""

    def __init__(self, runs: Mapping[str, ClosedLoop]) -> None:
        self._rows = {name: TipError(run.rmse, run.settled_rmse) for name, run in runs.items()}

    def __getitem__(self, name: str) -> TipError:
        return self._rows[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def _cells(self) -> list[tuple[str, ...]]:
        head = ("RMSE of the tip, m", "whole run", f"after {ClosedLoop.TRANSIENT:g} s")
        return [head, *((name, *(f"{one:.4f}" for one in row)) for name, row in self.items())]

    def __repr__(self) -> str:
        cells = self._cells()
        first, *others = (max(map(len, column)) for column in zip(*cells, strict=True))
        return "\n".join(
            "  ".join([row[0].ljust(first), *map(str.rjust, row[1:], others)]) for row in cells
        )

    def _repr_html_(self) -> str:
        rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self._cells())
        return f"<table>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


@dataclass(frozen=True)
class Comparison:
    """Closed-loop runs of several controllers over one scenario."""

    sea: Sea
    scenario: Scenario
    runs: Mapping[str, ClosedLoop]
    """By the name of the controller."""

    def errors(self) -> Errors:
        """Root mean square errors of the tip: a table, and by name."""
        return Errors(self.runs)

    def plot(self) -> tuple[Axes, Axes]:
        """Draw the elevation above the base and the tip's errors over time.

        Raises
        ------
        ImportError
            If there is no matplotlib.
        """
        axes: tuple[Axes, Axes] = _pictures().plot(self)
        return axes

    def animate(self) -> FuncAnimation:
        """Film the arms side by side; show it by ``to_jshtml()``, keep it by ``save()``.

        Raises
        ------
        ImportError
            If there is no matplotlib.
        """
        film: FuncAnimation = _pictures().animate(self)
        return film


def compare(
    parameters: ParameterSet,
    sea: Sea,
    target: ArrayLike,
    controllers: Iterable[Controller | Factory | str] | None = None,
    *,
    initial_angles: ArrayLike | None = None,
) -> Comparison:
    """Bring the tip to the target by each of several controllers, in the same sea.

    Parameters
    ----------
    parameters : ParameterSet
    sea : Sea
    target : array_like, (2,) or (T, 2)
        One point (x, z), in m, or the desired point at every control instant.
    controllers : iterable, optional
        Names in ``CONTROLLERS``, classes that are made of a scenario, or controllers of your
        own; all of ``CONTROLLERS`` unless they are named.
    initial_angles : array_like, (n,), optional
        Bending angles at the start, in rad; the arm is straight unless they are given.

    Raises
    ------
    ValueError
        If there is no controller of a name, or two have the same.
    """
    scenario = Scenario.build(parameters, sea, target, initial_angles)
    runs: dict[str, ClosedLoop] = {}
    for controller in CONTROLLERS if controllers is None else controllers:
        if (name := _name_of(controller)) in runs:
            raise ValueError(f"two controllers called {name!r}: give one of them another 'name'")
        runs[name] = simulate(scenario, controller)
    return Comparison(sea, scenario, runs)


def _name_of(controller: Any) -> str:
    """A name in ``CONTROLLERS``, an attribute ``name``, or the name of the class or function."""
    if isinstance(controller, str):
        return controller
    kind = controller if hasattr(controller, "__name__") else type(controller)
    return str(getattr(controller, "name", kind.__name__))


def _pictures() -> Any:
    try:
        from softwave_min.simulation import pictures  # noqa: PLC0415 - the library needs it not
    except ModuleNotFoundError as missing:
        raise ImportError(
            f"plot() and animate() need {missing.name}: pip install 'softwave-min[book]'"
        ) from None
    return pictures
