"""The measured effect of every other reading of the paper on its headline numbers.

Each switch of an open point gives parameter sets that differ from the nominal one in that
reading alone. Their headline numbers (`headlines`) are compared with the nominal ones in the
same random seas with the same noise. A difference has to be seen beside two others: the scatter of
the nominal numbers over seas, and the distance within which a claim of the paper counts as
reproduced.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.data import ParameterError
from softwave_min.experiments.places import in_realisation
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.paper.open_points import open_points
from softwave_min.paper.tolerance import PERCENT, tolerance
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance
from softwave_min.runs.statistics import interval
from softwave_min.studies.calibration import search_settings
from softwave_min.studies.cells import headline_cells, with_bounded_solves
from softwave_min.studies.headlines import HeadlineRun, attempted_numbers, headline_numbers

Floats = NDArray[np.float64]
Numbers = Mapping[str, NDArray[Any]]

OFFSETS = (0, 7)
"""Seas in which a reading is measured, counted from the nominal seeds of phases and noise.
They lie apart: a switch to the next seed must not meet the same seas again."""
SCATTER_SEAS = 20
"""Seas in which the nominal set is run to see what another sea does."""
SLOW = ("nmpc.solver", "simulation.integrator")
"""Fields whose other values find the same loops by a method that is up to several hundred times
slower: they are measured in `BRIEF`, at `BRIEF_PLACE` and in the first sea."""
BRIEF_PLACE = ("P3", 3.0)
"""Pose, and significant height in m."""
BRIEF = 1.5
"""Duration of their loops, in s: it has the start, where the solvers work most."""
REALISATIONS = "sea.realisations"
"""Its reading is not another loop but the median over that many seas."""
GROUPS: Mapping[str, str] = {
    "largest_reduction": "points",
    "lowest_reduction": "points",
    "rise": "points",
    "star": "m",
}
"""Groups of headline numbers, each with a number per wave case, and the unit of a change."""
FAILED = "solves_failed"
MEASURED = "measured"
"""Status of an alternative that could be run; else it says why not."""


@dataclass(frozen=True)
class Alternative:
    """One other value of one switch."""

    point: str
    field: str
    place: int
    """Among the switch's values."""
    value: Any
    parameters: ParameterSet | None
    refusal: str = ""
    """Why there are no parameters."""

    @property
    def name(self) -> str:
        """Stem of the names of its runs."""
        return f"{self.point}-{self.field.split('.')[1]}-{self.place + 1}"

    @property
    def written(self) -> str:
        """The value as in a parameter file; text without quotation marks."""
        return self.value if isinstance(self.value, str) else json.dumps(self.value)


def alternatives(parameters: ParameterSet) -> list[Alternative]:
    """Every other value of every switch of the open points, applied to the parameters."""
    nominal = _one_sea(parameters)
    found = []
    for point in open_points():
        for switch in point.switches:
            for place, value in enumerate(switch.values):
                try:
                    other, refusal = switch.applied(place, nominal), ""
                except ParameterError as error:
                    other, refusal = None, str(error)
                found.append(Alternative(point.id, switch.field, place, value, other, refusal))
    return found


def _one_sea(parameters: ParameterSet) -> ParameterSet:
    return replace(parameters, sea=replace(parameters.sea, realisations=1))


def group_of(number: str) -> str:
    """Group that a headline number belongs to; empty if to none."""
    stems = (number, *(number.removesuffix(f"_{case}") for case in wave_cases()))
    return next((stem for stem in stems if stem in GROUPS), "")


# --- runs -------------------------------------------------------------------------------


def offsets(field: str) -> tuple[int, ...]:
    """Seas in which a field is measured."""
    return OFFSETS[:1] if field in SLOW else OFFSETS


def loops(parameters: ParameterSet, field: str, offset: int) -> HeadlineRun:
    """The closed loops by which a parameter set is judged in one sea."""
    found, cells = with_bounded_solves(in_realisation(parameters, offset)), headline_cells()
    if field in SLOW:
        brief = replace(found.simulation, duration=min(BRIEF, found.simulation.duration))
        found = replace(found, simulation=brief)
        place = (poses()[BRIEF_PLACE[0]], BRIEF_PLACE[1])
        cells = replace(cells, grid=(place,), failures=(place,))
    return HeadlineRun(found, cells)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """The nominal set in all its seas and every alternative in its own; each once."""
    return list(_distinct(parameters).values())


def _distinct(parameters: ParameterSet) -> dict[HeadlineRun, Run]:
    """The runs by what they compute."""
    found: dict[HeadlineRun, Run] = {}
    for run in _named(parameters):
        found.setdefault(run.parameters, run)
    return found


def _named(parameters: ParameterSet) -> Iterator[Run]:
    """Every run that some number needs.

    What takes longest comes first. Then one sea follows the other, so that workers that share
    the runs do not begin with the same structure of the model, and compile it twice.
    """
    nominal, others = _one_sea(parameters), alternatives(parameters)
    yield Run("nominal-brief", headline_numbers, loops(nominal, SLOW[0], 0))
    yield from _in_sea(0, [one for one in others if one.field in SLOW])
    for offset in range(_scatter_seas(others)):
        yield Run(f"nominal-{offset}", headline_numbers, loops(nominal, "", offset))
    for offset in OFFSETS:
        yield from _in_sea(offset, [one for one in others if one.field not in SLOW])


def _in_sea(offset: int, others: Sequence[Alternative]) -> Iterator[Run]:
    for one in others:
        if one.parameters and one.field != REALISATIONS:
            run = loops(one.parameters, one.field, offset)
            yield Run(f"{one.name}-{offset}", attempted_numbers, run)


def _scatter_seas(others: Sequence[Alternative]) -> int:
    asked = (int(one.value) for one in others if one.field == REALISATIONS)
    return max((SCATTER_SEAS, *asked))


# --- tables -----------------------------------------------------------------------------


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Tables ``effects``, ``points`` and ``scatter``."""
    nominal, others = _one_sea(parameters), alternatives(parameters)
    of = {run: arrays[one.name] for run, one in _distinct(parameters).items()}
    seas = [of[loops(nominal, "", offset)] for offset in range(_scatter_seas(others))]
    scatter = _scatter_table(_stacked(seas))
    effects = pd.DataFrame(row for one in others for row in _effects(one, nominal, of, scatter))
    return {"effects": effects, "points": _point_table(effects, scatter), "scatter": scatter}


def _stacked(found: Sequence[Numbers]) -> dict[str, Floats]:
    """Numbers of several seas, (seas,) each."""
    return {name: np.array([float(one[name]) for one in found]) for name in found[0]}


def _scatter_table(found: Mapping[str, Floats]) -> pd.DataFrame:
    """What another sea does to each of the nominal numbers: their 90 % interval.

    ``scatter`` is half of it; ``allowance`` is that or the tolerance of a claim, if larger.
    """
    papers = {one.name: one.paper for one in search_settings().number if not one.at_most}
    rows = []
    for number in (one for one in found if one != FAILED):
        ends = interval(found[number])
        group = group_of(number)
        unit, paper = GROUPS.get(group, "points"), papers.get(number)
        scatter = (ends["high"] - ends["low"]) / 2
        widest = tolerance(paper or 0.0, PERCENT if unit == "points" else unit)
        rows.append(
            {
                "number": number,
                "group": group,
                "unit": unit,
                "paper": paper,
                "seas": len(found[number]),
                **ends,
                "scatter": scatter,
                "allowance": max(scatter, widest),
            }
        )
    return pd.DataFrame(rows)


def _effects(
    one: Alternative,
    nominal: ParameterSet,
    of: Mapping[HeadlineRun, Numbers],
    scatter: pd.DataFrame,
) -> Iterator[dict[str, Any]]:
    """A row for each number of an alternative.

    ``nominal``, ``alternative`` and ``difference`` are means over the seas, ``low`` and
    ``high`` the least and the largest difference in one of them; ``seconds`` is the duration of
    the loops.
    """
    usual = [loops(nominal, one.field, offset) for offset in offsets(one.field)]
    before = _stacked([of[run] for run in usual])
    status, after = _outcome(one, nominal, of, before)
    unknown = np.full(1, np.nan)
    for number in scatter.to_dict("records"):
        known = (before[number["number"]], after[number["number"]]) if after else (unknown, unknown)
        difference = known[1] - known[0]
        yield {
            "point": one.point,
            "field": one.field,
            "value": one.written,
            "number": number["number"],
            "group": number["group"],
            "status": status,
            "seas": len(difference) if after else 0,
            "seconds": usual[0].parameters.simulation.duration if after else 0.0,
            "nominal": known[0].mean(),
            "alternative": known[1].mean(),
            "difference": difference.mean(),
            "low": difference.min(),
            "high": difference.max(),
            "paper": number["paper"],
            "solves_failed": int(max(after[FAILED])) if after else 0,
        }


def _outcome(
    one: Alternative,
    nominal: ParameterSet,
    of: Mapping[HeadlineRun, Numbers],
    before: Mapping[str, Floats],
) -> tuple[str, dict[str, Floats]]:
    """Status of an alternative, and its numbers where it could be run, (seas,) each."""
    if one.parameters is None:
        return f"cannot be set: {one.refusal}", {}
    if one.field == REALISATIONS:
        many = _stacked([of[loops(nominal, "", offset)] for offset in range(one.value)])
        medians = {name: np.full_like(before[name], np.median(many[name])) for name in many}
        return MEASURED, {**medians, FAILED: before[FAILED]}
    found = [of[loops(one.parameters, one.field, offset)] for offset in offsets(one.field)]
    for numbers in found:
        if "failure" in numbers:
            return f"cannot run: {numbers['failure']}", {}
    return MEASURED, _stacked(found)


def _point_table(effects: pd.DataFrame, scatter: pd.DataFrame) -> pd.DataFrame:
    """A row for each switch, with the largest change in each group of numbers.

    Beside a change stand the value that makes it, whether it ``exceeds`` the scatter over seas,
    and how many ``times`` the allowance it is; a switch ``matters`` if some change is more
    than that.
    """
    usual = scatter.groupby("group")[["scatter", "allowance"]].max()
    rows = []
    for (point, field), own in effects.groupby(["point", "field"], sort=False):
        measured = own[own["status"] == MEASURED]
        other = own[own["status"] != MEASURED]["status"].unique()
        row: dict[str, Any] = {
            "point": point,
            "field": field,
            "values": own["value"].nunique(),
            "status": other[0] if len(other) else MEASURED,
            "seas": own["seas"].max(),
            "seconds": own["seconds"].max(),
        }
        for group, band in usual.loc[list(GROUPS)].iterrows():
            row |= _largest(str(group), measured[measured["group"] == group], band)
        row["times"] = np.nanmax([0.0, *(row[f"{group}_times"] for group in GROUPS)])
        row["exceeds"] = _yes(any(row[f"{group}_exceeds"] == "yes" for group in GROUPS))
        row["matters"] = _yes(row["times"] > 1)
        row["solves_failed"] = own["solves_failed"].max()
        rows.append(row)
    return pd.DataFrame(rows)


def _largest(group: str, changes: pd.DataFrame, band: pd.Series[float]) -> dict[str, Any]:
    """The largest change of a group's numbers."""
    change, value = np.nan, ""
    if len(changes):
        largest = changes.iloc[int(changes["difference"].abs().to_numpy().argmax())]
        change, value = float(largest["difference"]), largest["value"]
    return {
        group: change,
        f"{group}_at": value,
        f"{group}_exceeds": _yes(abs(change) > band["scatter"]),
        f"{group}_times": abs(change) / band["allowance"],
    }


def _yes(holds: bool) -> str:
    return "yes" if holds else "no"


EXPERIMENT = Experiment(
    name="open_points",
    title="What every other reading of the paper does to its headline numbers",
    claims=(),
    runs=runs,
    tabulate=tabulate,
    tolerances={
        # Differences of per cent that are themselves reproduced to 1e-4, hence points.
        column: Tolerance(relative=1e-3, absolute=0.05)
        for column in (
            *("nominal", "alternative", "difference", "low", "high"),
            *("median", "scatter", "allowance"),
            *GROUPS,
        )
    }
    | {"star": Tolerance(relative=1e-3, absolute=1e-4)}
    | {
        name: Tolerance(relative=1e-2, absolute=0.05)
        for name in ("times", *(f"{group}_times" for group in GROUPS))
    },
    on_request=True,
)
