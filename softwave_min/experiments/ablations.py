r"""What each part of controller, forecast, load and opponent is worth: one changed at a time.

Every variant is run in the same places and the same seas, with the same noise where it has any
(common random numbers), so that a variant and its nominal loop can be compared cell by cell.

The grid is a half of wave case x height x pose x sea: each sea has two of four poses, one near
the base and one far from it, one above the base and one below, and the pairs change places from
one sea to the next. A trend with the case, the height or the pose is balanced over the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.arm import Arm
from softwave_min.control.baseline import KinematicPlanner
from softwave_min.experiments import star
from softwave_min.experiments.closed_loop import (
    LoopRun,
    failed_solves,
    fallbacks,
    scenario_of,
    settled_error,
    summary_arrays,
    whole_error,
)
from softwave_min.experiments.places import in_sea, realisations
from softwave_min.experiments.star_path import StarParameters
from softwave_min.experiments.zero_order_hold import held_flow, simulate_told
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance
from softwave_min.runs.statistics import over_seas
from softwave_min.simulation import ClosedLoop, Scenario, compile_engine, simulate

SEEDS = 3
"""Random seas, unless the parameters ask for more than one."""
HEIGHTS = (0.5, 1.5, 3.0)
"""Significant heights, in m."""
POSE_PAIRS = (("P1", "P6"), ("P4", "P3"))
"""Near and far, above and below: taken in turns."""
HORIZONS = (5, 10, 15, 20, 30, 40)
"""In control periods."""
DELAYS = (1, 2, 5, 10)
"""Of the forecast, in control periods."""
SLOWER = (3, 5)
"""Factors on the control period that make the control slow."""
NMPC, BASELINE = "nmpc", "baseline"
"""Names of the nominal loops."""

Window = Literal["whole", "settled"]
WINDOWS: tuple[Window, ...] = ("whole", "settled")
Changes = tuple[tuple[str, Any], ...]
RunData = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Variant:
    """A closed loop with one part changed."""

    name: str
    group: str
    label: str
    controller: str
    changes: Changes = ()
    """Fields of the parameter set as 'section.name', and their values."""
    held_flow: bool = False
    """Whether the NMPC takes the present flow to last."""
    opponent: str = ""
    """Loop of the other controller that it is compared with; the nominal one if empty."""

    @property
    def nominal(self) -> str:
        """Loop of the same controller that it is compared with."""
        return self.controller

    @property
    def rival(self) -> str:
        """Loop of the other controller that it is compared with."""
        return self.opponent or (BASELINE if self.controller == "nmpc" else NMPC)


@dataclass(frozen=True)
class PlaceRun:
    """All that determines the loops at one pose in one sea."""

    parameters: ParameterSet
    pose: tuple[float, float]
    variants: tuple[Variant, ...]


@dataclass(frozen=True)
class PathRun:
    """All that determines the loops on the star in one sea."""

    parameters: ParameterSet
    path: StarParameters
    variants: tuple[Variant, ...]


@dataclass(frozen=True)
class Place:
    """A pose in a sea."""

    wave: str
    pose: str
    significant_height: float
    parameters: ParameterSet

    @property
    def name(self) -> str:
        """Unique in the experiment."""
        height = f"{self.significant_height:g}".replace(".", "_")
        return f"{self.wave}-{self.pose}-{height}-{self.parameters.sea.seed}"

    @property
    def labels(self) -> dict[str, Any]:
        """Columns that name the place."""
        return {
            "wave": self.wave,
            "pose": self.pose,
            "Hs": self.significant_height,
            "seed": self.parameters.sea.seed,
        }


def integral_gain(parameters: ParameterSet) -> float:
    r"""Gain of the integral action by Kessler's magnitude optimum, in 1/s.

    :math:`K_I = 1/(2 T_\Sigma)` is the greatest gain for which :math:`K_I/(s(1 + T_\Sigma s))`,
    closed, has no resonance (damping :math:`1/\sqrt 2`). The lags are the arm's, by
    `star.inner_loop_time` in still water, the longest over the paper's poses, and
    half a control period each for the held command and for Euler's rule.
    """
    period = parameters.nmpc.control_period
    arm = Arm(parameters.arm, parameters.fluid)
    planner = KinematicPlanner(arm, parameters.baseline, period)
    steps = round(parameters.simulation.duration / period)
    postures = [
        planner.path(np.zeros(arm.segments), np.tile(pose, (steps, 1)))[-1]
        for pose in poses().values()
    ]
    lags = [star.inner_loop_time(parameters, posture) for posture in postures]
    return float(f"{1 / (2 * (max(lags) + period)):.4g}")


def variants(parameters: ParameterSet) -> tuple[Variant, ...]:
    """The nominal loops, and every loop with one part changed."""
    period, horizon = parameters.nmpc.control_period, parameters.nmpc.horizon
    gain = integral_gain(parameters)
    integral = (("baseline.integral_gain", gain),)
    feedforward = (("baseline.load_feedforward", True),)
    textbook = (("fluid.morison", "textbook"),)

    def forecast(name: str, label: str, *changes: tuple[str, Any], held: bool = False) -> Variant:
        return Variant(f"preview_{name}", "preview", label, "nmpc", changes, held)

    def fairer(name: str, label: str, *changes: tuple[str, Any]) -> Variant:
        return Variant(f"baseline_{name}", "opponent", label, "baseline", changes)

    return (
        Variant(NMPC, "nominal", "NMPC", "nmpc"),
        Variant(BASELINE, "nominal", "baseline", "baseline"),
        forecast("exact", "exact", ("preview.noise", "none")),
        forecast("ratio", "SNR as a ratio", ("preview.noise", "ratio")),
        *(
            forecast(
                f"late_{delay}", f"{delay * period:g} s late", ("preview.delay_periods", delay)
            )
            for delay in DELAYS
        ),
        forecast("present", "present flow, held", held=True),
        forecast("none", "still water", ("preview.waves", False), ("preview.noise", "none")),
        Variant(
            f"textbook_{NMPC}", "load", "NMPC", "nmpc", textbook, opponent=f"textbook_{BASELINE}"
        ),
        Variant(
            f"textbook_{BASELINE}",
            "load",
            "baseline",
            "baseline",
            textbook,
            opponent=f"textbook_{NMPC}",
        ),
        fairer("integral_half", "integral, half gain", ("baseline.integral_gain", gain / 2)),
        fairer("integral", "integral", *integral),
        fairer("integral_twice", "integral, twice gain", ("baseline.integral_gain", 2 * gain)),
        fairer("feedforward", "load feed-forward", *feedforward),
        fairer("both", "both", *integral, *feedforward),
        *(
            Variant(f"horizon_{K}", "horizon", f"K = {K}", "nmpc", (("nmpc.horizon", K),))
            for K in HORIZONS
            if horizon != K
        ),
    )


def path_variants(parameters: ParameterSet) -> tuple[Variant, ...]:
    """The NMPC on the star, as it is and with slow control (C69).

    Slow control has the same horizon in seconds, whose end counts lest little be left of it; the
    same steps of plant and predictor; and the same weight on the rate of the command, which is R
    times the square of the period.
    """
    nmpc, plant = parameters.nmpc, parameters.simulation

    def slower(factor: int) -> Changes:
        return (
            ("nmpc.control_period", factor * nmpc.control_period),
            ("nmpc.horizon", max(round(nmpc.horizon / factor), 1)),
            ("nmpc.terminal_weight", 1.0),
            ("nmpc.step_weight", nmpc.step_weight / factor**2),
            ("nmpc.substeps", factor * nmpc.substeps),
            ("simulation.extrapolated_steps", factor * plant.extrapolated_steps),
        )

    return (
        Variant("period_1", "control", "nominal", "nmpc"),
        *(
            Variant(f"period_{factor}", "control", f"{factor} times slower", "nmpc", slower(factor))
            for factor in SLOWER
        ),
    )


def varied(parameters: ParameterSet, changes: Changes) -> ParameterSet:
    """The parameters with other values of the fields 'section.name'."""
    for field, value in changes:
        section, name = field.split(".")
        part = replace(getattr(parameters, section), **{name: value})
        parameters = replace(parameters, **{section: part})
    return parameters


def in_seas(parameters: ParameterSet) -> Iterator[ParameterSet]:
    """The parameters in each of the seas that this experiment takes."""
    asked = parameters.sea.realisations
    count = asked if asked > 1 else SEEDS
    return realisations(replace(parameters, sea=replace(parameters.sea, realisations=count)))


def places(parameters: ParameterSet) -> Iterator[Place]:
    """The half grid: every wave case, height and sea with one pair of poses."""
    seas = product(enumerate(wave_cases()), enumerate(HEIGHTS), enumerate(in_seas(parameters)))
    for (i, wave), (j, height), (k, one) in seas:
        for pose in POSE_PAIRS[(i + j + k) % 2]:
            yield Place(wave, pose, height, in_sea(one, wave, height))


def _path_seas(parameters: ParameterSet) -> Iterator[tuple[str, ParameterSet]]:
    chosen = star.choice()
    for wave in chosen.rmse:
        for one in in_seas(parameters):
            yield wave, in_sea(one, wave, chosen.significant_height)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """One run for each place, with all variants, and one for the star in each sea."""
    compared = variants(parameters)
    found = [
        Run(place.name, loops, PlaceRun(place.parameters, poses()[place.pose], compared))
        for place in places(parameters)
    ]
    followed, path = path_variants(parameters), star.choice().path
    for wave, one in _path_seas(parameters):
        found.append(Run(_path_name(wave, one), loops, PathRun(one, path, followed)))
    return found


def _path_name(wave: str, parameters: ParameterSet) -> str:
    return f"star-{wave}-{parameters.sea.seed}"


def loops(run: PlaceRun | PathRun) -> RunData:
    """Simulate all variants; of each by name what it is ``judged`` by."""
    found: RunData = {}
    for variant in run.variants:
        scenario = _scenario(run, varied(run.parameters, variant.changes))
        found |= summary_arrays(loop_of(scenario, variant), variant.name)
    return found


def _scenario(run: PlaceRun | PathRun, parameters: ParameterSet) -> Scenario:
    if isinstance(run, PathRun):
        return star.scenario_of(parameters, run.path)
    return scenario_of(LoopRun(parameters, (run.pose,)))


def loop_of(scenario: Scenario, variant: Variant) -> ClosedLoop:
    """The closed loop of a variant, whose changes the scenario has already."""
    if variant.held_flow:
        return simulate_told(scenario, held_flow)
    return simulate(scenario, variant.controller)


def prepare(run: Run) -> None:
    """Compile what the variants need, those on the star included."""
    parameters = run.parameters.parameters
    for variant in (*variants(parameters), *path_variants(parameters)):
        compile_engine(varied(parameters, variant.changes))


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Tables ``ablations``, ``summary``, ``by_height``, ``by_wave``, ``speed``, ``spreads``."""
    compared = variants(parameters)
    table = _cell_table(parameters, arrays, compared)
    long = _compared(table, compared)
    speed = _speed_table(parameters, arrays)
    return {
        "ablations": table,
        "summary": _summary(long, compared),
        "by_height": _medians(long, "Hs"),
        "by_wave": _medians(long, "wave"),
        "speed": speed,
        "spreads": _spreads(speed),
    }


def _measured(parameters: ParameterSet, data: Any, variant: Variant) -> dict[str, Any]:
    """Errors of a loop in m, and what went wrong in it."""
    name, period = variant.name, varied(parameters, variant.changes).nmpc.control_period
    return {
        "e_whole": whole_error(data, name),
        "e_settled": settled_error(data, name, period),
        "solves_failed": failed_solves(data, name),
        "fallbacks": fallbacks(data, name),
    }


def _cell_table(
    parameters: ParameterSet, arrays: RunArrays, compared: Sequence[Variant]
) -> pd.DataFrame:
    """One row per variant and place; ratios to the nominal loops in the same sea."""
    rows: list[dict[str, Any]] = []
    for variant in compared:
        for place in places(parameters):
            data = arrays[place.name]
            found = _measured(place.parameters, data, variant)
            row = {"variant": variant.name, "group": variant.group, **place.labels}
            for name in (NMPC, BASELINE):
                nominal = next(one for one in compared if one.name == name)
                against = _measured(place.parameters, data, nominal)
                row[f"ratio_{name}"] = found["e_whole"] / against["e_whole"]
                row[f"ratio_{name}_settled"] = found["e_settled"] / against["e_settled"]
            rows.append(row | found)
    order = ["variant", "group", "wave", "pose", "Hs", "seed", "e_whole", "e_settled"]
    ratios = [f"ratio_{name}{end}" for name in (NMPC, BASELINE) for end in ("", "_settled")]
    return pd.DataFrame(rows)[[*order, *ratios, "solves_failed", "fallbacks"]]


def _compared(table: pd.DataFrame, compared: Sequence[Variant]) -> pd.DataFrame:
    """One row per variant, place and window.

    ``ratio``: its error over that of the nominal loop of the same controller. ``against``: the
    error of the NMPC over that of the other controller's loop.
    """
    place = ["wave", "pose", "Hs", "seed"]
    parts: list[pd.DataFrame] = []
    for window in WINDOWS:
        errors = table.pivot_table(index=place, columns="variant", values=f"e_{window}")
        for variant in compared:
            own, rival = errors[variant.name], errors[variant.rival]
            part = pd.DataFrame(
                {
                    "ratio": own / errors[variant.nominal],
                    "against": own / rival if variant.controller == "nmpc" else rival / own,
                }
            ).reset_index()
            parts.append(part.assign(variant=variant.name, group=variant.group, window=window))
    return pd.concat(parts, ignore_index=True)


def _summary(long: pd.DataFrame, compared: Sequence[Variant]) -> pd.DataFrame:
    """One row per variant and window, over all cells.

    ``ratio`` and ``against`` are medians of what `_compared` has, ``_low`` and ``_high`` hold
    90 % of the cells; ``_least`` and ``_most`` are the smallest and the largest of the medians
    of single seas; ``order`` is the share of cells in which the NMPC has the smaller error.
    """
    rows: list[dict[str, Any]] = []
    for variant, window in product(compared, WINDOWS):
        cells = long[(long["variant"] == variant.name) & (long["window"] == window)]
        row: dict[str, Any] = {
            "variant": variant.name,
            "group": variant.group,
            "label": variant.label,
            "controller": variant.controller,
            "rival": variant.rival,
            "window": window,
            "cells": len(cells),
            "seas": cells["seed"].nunique(),
        }
        for name in ("ratio", "against"):
            low, median, high = over_seas(cells[name])
            of_seas = cells.groupby("seed")[name].median()
            row |= {name: median, f"{name}_low": low, f"{name}_high": high}
            row |= {f"{name}_least": of_seas.min(), f"{name}_most": of_seas.max()}
        rows.append(row | {"order": float((cells["against"] < 1).mean())})
    return pd.DataFrame(rows)


def _medians(long: pd.DataFrame, by: str) -> pd.DataFrame:
    """Medians over the cells with the same wave case or height, and the share in order."""
    groups = long.groupby(["variant", "group", "window", by], sort=False)
    table = groups[["ratio", "against"]].median()
    table["order"] = groups["against"].apply(lambda column: float((column < 1).mean()))
    return table.reset_index()


def _speed_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """One row per loop on the star: control period in s, wave case and sea."""
    rows = [
        {
            "variant": variant.name,
            "label": variant.label,
            "control_period": varied(one, variant.changes).nmpc.control_period,
            "wave": wave,
            "seed": one.sea.seed,
            **_measured(one, arrays[_path_name(wave, one)], variant),
        }
        for variant in path_variants(parameters)
        for wave, one in _path_seas(parameters)
    ]
    return pd.DataFrame(rows)


def _spreads(speed: pd.DataFrame) -> pd.DataFrame:
    """Mean error over the wave cases in m, and its range over them as a share of the mean.

    Both are taken in each sea first; the numbers are the median, the smallest and the
    largest over the seas.
    """
    rows: list[dict[str, Any]] = []
    keys = ["variant", "label", "control_period"]
    for found, cells in speed.groupby(keys, sort=False):
        named = dict(zip(keys, found, strict=True))
        for window in WINDOWS:
            by_sea = cells.pivot_table(index="seed", columns="wave", values=f"e_{window}")
            error = by_sea.mean(axis=1)
            spread = (by_sea.max(axis=1) - by_sea.min(axis=1)) / error
            rows.append(
                {
                    **named,
                    "window": window,
                    "seas": len(by_sea),
                    "error": error.median(),
                    "spread": spread.median(),
                    "spread_least": spread.min(),
                    "spread_most": spread.max(),
                }
            )
    return pd.DataFrame(rows)


EXPERIMENT = Experiment(
    name="ablations",
    title="What each part is worth: forecast, load, opponent and horizon, one at a time",
    claims=(),
    runs=runs,
    tabulate=tabulate,
    prepare=prepare,
    tolerances={
        # Quotients of errors that are themselves reproduced to 1e-4.
        column: Tolerance(relative=5e-4)
        for column in (
            *("ratio", "ratio_low", "ratio_high", "ratio_least", "ratio_most"),
            *("against", "against_low", "against_high", "against_least", "against_most"),
            *("ratio_nmpc", "ratio_nmpc_settled", "ratio_baseline", "ratio_baseline_settled"),
            *("spread", "spread_least", "spread_most"),
        )
    },
    on_request=True,
)
