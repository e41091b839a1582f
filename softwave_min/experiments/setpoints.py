"""The paper's Fig. various_setpoints: which poses an arm with a failed segment holds (C44-C47).

Each pose is asked for twice. The kinematics say how close any posture at rest brings
the tip, whatever the controller. The NMPC, in still water and from the straight arm,
says which posture it ends in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from softwave_min.experiments.failures import INTACT, failure_cases
from softwave_min.experiments.resting_arm import REACHED, Reach, RestRun, area, at_rest, reach
from softwave_min.paper.cases import poses
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run, RunArrays, Tables, Tolerance

REST = 15.0
"""Seconds in still water after which the NMPC's posture is taken."""


def runs(parameters: ParameterSet) -> Sequence[Run]:
    """For each case, what the kinematics allow and where the NMPC ends."""
    still = replace(
        parameters,
        sea=replace(parameters.sea, significant_height=0.0, realisations=1),
        simulation=replace(parameters.simulation, duration=REST),
    )
    targets = tuple(poses().values())
    found: list[Run] = []
    for name, case in failure_cases(parameters).items():
        failed = case.of(still)
        question = Reach(failed.arm, failed.fluid, failed.failure, failed.nmpc.angle_bound, targets)
        found += [
            Run(f"rest-{name}", at_rest, RestRun(failed, targets)),
            Run(f"reach-{name}", reach, question),
        ]
    return found


def tabulate(parameters: ParameterSet, arrays: RunArrays) -> Tables:
    """Poses and areas of the workspace, for each case."""
    cases = failure_cases(parameters)
    areas = {name: area(arrays[f"reach-{name}"]["workspace"]) for name in cases}
    whole = areas[INTACT][0]
    return {
        "setpoints": pd.concat([_poses_of(name, arrays) for name in cases], ignore_index=True),
        "workspace": pd.DataFrame(
            {"case": name, "area": size, "resolution": error, "share": size / whole}
            for name, (size, error) in areas.items()
        ),
    }


def _poses_of(case: str, arrays: RunArrays) -> pd.DataFrame:
    allowed, rest = arrays[f"reach-{case}"], arrays[f"rest-{case}"]
    angles = {f"q{number}": angle for number, angle in enumerate(rest["q"].T, start=1)}
    return pd.DataFrame(
        {
            "case": case,
            "pose": list(poses()),
            **angles,
            "error": rest["error"],
            "distance_left": allowed["distance"],
            "reachable": allowed["distance"] < REACHED,
            "solves_failed": np.count_nonzero(rest["status"] > 0, axis=1),
            "fallbacks": np.count_nonzero(rest["source"], axis=1),
        }
    )


EXPERIMENT = Experiment(
    name="setpoints",
    title="Postures at the paper's poses and the workspace, with and without a failed segment",
    claims=("C15", "C16", "C17", "C18", "C19", "C20", "C44", "C45", "C46", "C47", "C70"),
    runs=runs,
    tabulate=tabulate,
    tolerances={
        # A cell of the map more or less, as rounding decides.
        "area": Tolerance(absolute=2e-3),
        "resolution": Tolerance(absolute=2e-3),
        "share": Tolerance(absolute=2e-3),
        # Along the arm's redundancy the last digits of an angle cost nothing.
        **{f"setpoints.q{i}": Tolerance(absolute=1e-3) for i in range(1, 10)},
    },
)
