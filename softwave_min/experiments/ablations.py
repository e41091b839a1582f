r"""What each part of controller, forecast, load and opponent is worth: one changed at a time.

Every ablation is run in the same places and the same seas, with the same noise where it has any
(common random numbers), so that it can be compared with its nominal loop cell by cell.

The grid is a half of wave case x height x pose x sea: each sea has two of four poses, one near
the base and one far from it, one above the base and one below, and the pairs change places from
one sea to the next. A trend with the case, the height or the pose is balanced over the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from operator import itemgetter
from typing import Any

import numpy as np
import pandas as pd

from softwave_min.arm import Arm
from softwave_min.control.baseline import KinematicPlanner
from softwave_min.experiments import star
from softwave_min.experiments.ablation_loops import (
    BASELINE,
    NMPC,
    Ablation,
    AblationRun,
    Changes,
    loops,
    varied,
)
from softwave_min.experiments.closed_loop import (
    WINDOWS,
    RunData,
    failed_solves,
    fallbacks,
    settled_error,
    whole_error,
)
from softwave_min.experiments.places import Place, at_least, in_sea, realisations
from softwave_min.experiments.star_loops import inner_loop_time
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance
from softwave_min.runs.statistics import over_seas

SEAS = 3
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


def integral_gain(parameters: ParameterSet) -> float:
    r"""Gain of the integral action by Kessler's magnitude optimum, in 1/s.

    :math:`K_I = 1/(2 T_\Sigma)` is the greatest gain for which :math:`K_I/(s(1 + T_\Sigma s))`,
    closed, has no resonance (damping :math:`1/\sqrt 2`). The lags are the arm's, by
    `inner_loop_time` in still water, the longest over the paper's poses, and
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
    lags = [inner_loop_time(parameters, posture) for posture in postures]
    return float(f"{1 / (2 * (max(lags) + period)):.4g}")


def pose_ablations(parameters: ParameterSet) -> tuple[Ablation, ...]:
    """The nominal loops, and every loop with one part changed."""
    period, horizon = parameters.nmpc.control_period, parameters.nmpc.horizon
    gain = integral_gain(parameters)
    integral, feedforward = ("baseline.integral_gain", gain), ("baseline.load_feedforward", True)
    textbook = (("fluid.morison", "textbook"),)

    def forecast(name: str, label: str, *changes: tuple[str, Any], hold: bool = False) -> Ablation:
        return Ablation(f"preview_{name}", "preview", label, NMPC, changes, hold)

    def fairer(name: str, label: str, *changes: tuple[str, Any]) -> Ablation:
        return Ablation(f"baseline_{name}", "opponent", label, BASELINE, changes)

    return (
        Ablation(NMPC, "nominal", "NMPC", "nmpc"),
        Ablation(BASELINE, "nominal", "baseline", "baseline"),
        forecast("exact", "exact", ("preview.noise", "none")),
        forecast("ratio", "SNR as a ratio", ("preview.noise", "ratio")),
        *(
            forecast(f"late_{one}", f"{one * period:g} s late", ("preview.delay_periods", one))
            for one in DELAYS
        ),
        forecast("present", "present flow, held", hold=True),
        forecast("none", "still water", ("preview.waves", False), ("preview.noise", "none")),
        *(
            Ablation(f"textbook_{one}", "load", label, one, textbook, opponent=f"textbook_{other}")
            for one, label, other in ((NMPC, "NMPC", BASELINE), (BASELINE, "baseline", NMPC))
        ),
        fairer("integral_half", "integral, half gain", ("baseline.integral_gain", gain / 2)),
        fairer("integral", "integral", integral),
        fairer("integral_twice", "integral, twice gain", ("baseline.integral_gain", 2 * gain)),
        fairer("feedforward", "load feed-forward", feedforward),
        fairer("both", "both", integral, feedforward),
        *(
            Ablation(f"horizon_{K}", "horizon", f"K = {K}", "nmpc", (("nmpc.horizon", K),))
            for K in HORIZONS
            if horizon != K
        ),
    )


def star_ablations(parameters: ParameterSet) -> tuple[Ablation, ...]:
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
        Ablation("period_1", "control", "nominal", "nmpc"),
        *(
            Ablation(f"period_{one}", "control", f"{one} times slower", "nmpc", slower(one))
            for one in SLOWER
        ),
    )


def half_grid(parameters: ParameterSet) -> Iterator[Place]:
    """Every wave case, height and sea with one pair of poses."""
    seas = enumerate(realisations(at_least(parameters, SEAS)))
    for (i, wave), (j, height), (k, one) in product(
        enumerate(wave_cases()), enumerate(HEIGHTS), seas
    ):
        for pose in POSE_PAIRS[(i + j + k) % 2]:
            yield Place(wave, pose, in_sea(one, wave, height))


def _on_star(parameters: ParameterSet) -> list[tuple[str, str, ParameterSet]]:
    """Name of the run, wave case and parameters of each sea for the star, case by case."""
    seas = sorted(star.seas_of(at_least(parameters, SEAS)), key=itemgetter(0))
    return [(f"star-{wave}-{one.sea.seed}", wave, one) for wave, one in seas]


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """One run for each place, with all ablations, and one for the star in each sea."""
    compared, followed = pose_ablations(parameters), star_ablations(parameters)
    path = star.choice().path
    return [
        *(
            Run(place.run_name(), loops, AblationRun(place.parameters, place.path[0], compared))
            for place in half_grid(parameters)
        ),
        *(
            Run(name, loops, AblationRun(one, path, followed))
            for name, _, one in _on_star(parameters)
        ),
    ]


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Tables ``ablations``, ``summary``, ``by_height``, ``by_wave``, ``speed``, ``spreads``."""
    compared = pose_ablations(parameters)
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


def _measured(parameters: ParameterSet, data: RunData, ablation: Ablation) -> dict[str, Any]:
    """Errors of a loop in m, and what went wrong in it."""
    name, period = ablation.name, varied(parameters, ablation.changes).nmpc.control_period
    return {
        "e_whole": whole_error(data, name),
        "e_settled": settled_error(data, name, period),
        "solves_failed": failed_solves(data, name),
        "fallbacks": fallbacks(data, name),
    }


def _cell_table(
    parameters: ParameterSet, arrays: RunArrays, compared: Sequence[Ablation]
) -> pd.DataFrame:
    """One row per ablation and place; ratios to the nominal loops in the same sea."""
    table = pd.DataFrame(
        {"variant": one.name, "group": one.group, **place.labels}
        | _measured(parameters, arrays[place.run_name()], one)
        for one, place in product(compared, half_grid(parameters))
    )
    failures = table[["solves_failed", "fallbacks"]]
    table = table.drop(columns=failures.columns)
    for name, (window, ending) in product((NMPC, BASELINE), WINDOWS.items()):
        nominal = table.loc[table["variant"] == name, f"e_{window}"]
        table[f"ratio_{name}{ending}"] = table[f"e_{window}"] / np.tile(nominal, len(compared))
    return table.join(failures)


def _compared(table: pd.DataFrame, compared: Sequence[Ablation]) -> pd.DataFrame:
    """One row per ablation, place and window.

    ``ratio``: its error over that of the nominal loop of the same controller. ``against``: the
    error of the NMPC over that of the other controller's loop.
    """
    place = ["wave", "pose", "Hs", "seed"]
    parts = []
    for window in WINDOWS:
        errors = table.pivot_table(index=place, columns="variant", values=f"e_{window}")
        for one in compared:
            own, rival = errors[one.name], errors[one.rival]
            part = pd.DataFrame(
                {
                    "ratio": own / errors[one.controller],
                    "against": own / rival if one.controller == NMPC else rival / own,
                }
            ).reset_index()
            parts.append(part.assign(variant=one.name, group=one.group, window=window))
    return pd.concat(parts, ignore_index=True)


def _summary(long: pd.DataFrame, compared: Sequence[Ablation]) -> pd.DataFrame:
    """One row per ablation and window, over all cells.

    ``ratio`` and ``against`` are medians of what `_compared` has, ``_low`` and ``_high`` hold
    90 % of the cells; ``_least`` and ``_most`` are the smallest and the largest of the medians
    of single seas; ``order`` is the share of cells in which the NMPC has the smaller error.
    """
    rows = []
    for one, window in product(compared, WINDOWS):
        cells = long[(long["variant"] == one.name) & (long["window"] == window)]
        row: dict[str, Any] = {
            "variant": one.name,
            "group": one.group,
            "label": one.label,
            "controller": one.controller,
            "rival": one.rival,
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
    groups = long.assign(order=long["against"] < 1).groupby(
        ["variant", "group", "window", by], sort=False
    )
    how = {"ratio": "median", "against": "median", "order": "mean"}
    return groups.agg(how).reset_index()


def _speed_table(parameters: ParameterSet, arrays: RunArrays) -> pd.DataFrame:
    """One row per loop on the star: control period in s, wave case and sea."""
    return pd.DataFrame(
        {
            "variant": ablation.name,
            "label": ablation.label,
            "control_period": varied(one, ablation.changes).nmpc.control_period,
            "wave": wave,
            "seed": one.sea.seed,
            **_measured(one, arrays[name], ablation),
        }
        for ablation in star_ablations(parameters)
        for name, wave, one in _on_star(parameters)
    )


def _spreads(speed: pd.DataFrame) -> pd.DataFrame:
    """Mean error over the wave cases in m, and its range over them as a share of the mean.

    Both are taken in each sea first; the numbers are the median, the smallest and the
    largest over the seas.
    """
    rows = []
    keys = ["variant", "label", "control_period"]
    for (found, cells), window in product(speed.groupby(keys, sort=False), WINDOWS):
        by_sea = cells.pivot_table(index="seed", columns="wave", values=f"e_{window}")
        spread = star.relative_range(by_sea)
        rows.append(
            {
                **dict(zip(keys, found, strict=True)),
                "window": window,
                "seas": len(by_sea),
                "error": by_sea.mean(axis=1).median(),
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
    tolerances={
        # Quotients of errors that are themselves reproduced to 1e-4.
        column: Tolerance(relative=5e-4)
        for column in (
            *(
                f"{name}{ending}"
                for name in ("ratio", "against")
                for ending in ("", "_low", "_high", "_least", "_most")
            ),
            *("ratio_nmpc", "ratio_nmpc_settled", "ratio_baseline", "ratio_baseline_settled"),
            *("spread", "spread_least", "spread_most"),
        )
    },
    on_request=True,
)
