"""Loads of the water on a fixed arm: what the paper gives as causes of the error (C41-C43).

The paper says why some poses are better than others: curvature and depth lower the torque of
the waves. An arm that is fixed in the posture of each pose, and then raised and lowered as a
whole, shows what either does alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from softwave_min.experiments.fixed_arm_loads import FixedArm, fixed_arm_loads
from softwave_min.experiments.places import Place, in_sea, realisations
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables
from softwave_min.waves import wave_number

Row = dict[str, float | int | str]

RISES = (0.6, 0.0, -0.6, -1.2, -2.4, -4.8)
"""How far the arm's base is raised, in m; the first takes a target at -4.3 m to -3.7 m."""


def seas(parameters: ParameterSet) -> Iterator[tuple[str, Run]]:
    """One run per wave case and random sea at the greatest height, after the case's name."""
    bed = -parameters.sea.depth + sum(parameters.arm.length)
    rises = tuple(rise for rise in RISES if parameters.arm.base_position[1] + rise > bed)
    targets = tuple(poses().values())
    for wave, case in wave_cases().items():
        for one in realisations(in_sea(parameters, wave, max(case.significant_height))):
            fixed = FixedArm(one, targets, rises)
            yield wave, Run(f"{wave}-{one.sea.seed}", fixed_arm_loads, fixed)


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """The arm fixed at every pose, in every wave case and random sea."""
    return [run for _, run in seas(parameters)]


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """The loads on the arm in each posture, and at each depth.

    ``postures`` (C41): `curvature` and `torque_columns`; ``torque_uniform``: without the
    variation of the flow along the arm, in N m. ``depth`` (C42, C43): loads at every depth
    ``z`` of the base, in m, beside linear theory's decay; ``speed`` of the water at the base,
    in m/s; ``decay``: exp(k (z - z_0)) for the wave number k of the peak and the operating
    depth z_0.
    """
    postures, depth = [], []
    for wave, run in seas(parameters):
        fixed, data = run.parameters, arrays[run.name]
        operating, k = fixed.rises.index(0.0), peak_wave_number(fixed.parameters)
        for number, pose in enumerate(poses()):
            labels, torque = Place(wave, pose, fixed.parameters).labels, data["torque"][number]
            postures.append(
                {
                    **labels,
                    "curvature": curvature(data["angles"][number], fixed.parameters),
                    **torque_columns(torque[operating]),
                    "torque_uniform": float(np.linalg.norm(data["torque_uniform"][number])),
                }
            )
            depth += [
                {
                    **labels,
                    "z": round(fixed.parameters.arm.base_position[1] + rise, 6),
                    **torque_columns(torque[level]),
                    "speed": float(data["speed"][level]),
                    "decay": float(np.exp(k * rise)),
                }
                for level, rise in enumerate(fixed.rises)
            ]
    return {"postures": pd.DataFrame(postures), "depth": pd.DataFrame(depth)}


def curvature(posture: NDArray[np.float64], parameters: ParameterSet) -> float:
    """Mean curvature of a posture, sum |q_i| / sum L_i, in 1/m."""
    return float(np.abs(posture).sum() / sum(parameters.arm.length))


def torque_columns(levels: NDArray[np.float64]) -> Row:
    """``torque_i``: root mean square of the load on segment i's angle, in N m; ``torque``: of all.

    ``torque`` is the root mean square of the load's norm over the segments.
    """
    each: Row = {f"torque_{i}": float(level) for i, level in enumerate(levels, start=1)}
    return {"torque": float(np.linalg.norm(levels)), **each}


def peak_wave_number(parameters: ParameterSet) -> float:
    """Wave number of the peak, in 1/m."""
    frequency = 2 * np.pi / parameters.sea.peak_period
    return float(wave_number(frequency, parameters.sea.depth, parameters.fluid.gravity))


EXPERIMENT = Experiment(
    name="fixed_arm",
    title="Loads of the water on a fixed arm, in each pose and at several depths",
    claims=("C41", "C42", "C43"),
    runs=runs,
    tabulate=tabulate,
)
