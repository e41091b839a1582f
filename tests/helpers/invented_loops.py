"""Closed loops that nobody computed: tables and figures need no more to be tested."""

from io import StringIO
from types import SimpleNamespace

import numpy as np

from softwave_min.runs.store import read_table, table_text
from softwave_min.simulation import CONTROLLERS

STEPS = 120


def invented(run, segments):
    """Arrays as a run's, one controller twice as bad as the next."""
    names = getattr(run.parameters, "controllers", tuple(CONTROLLERS))
    level = 0.01 * (2 + run.parameters.parameters.failure.segment)
    rng = np.random.default_rng(3)
    found = {}
    for number, name in enumerate(names):
        error = np.full(STEPS + 1, level * 2.0**-number)
        found |= {
            f"{name}_error": error,
            f"{name}_tip": np.stack([error, 0 * error], axis=1),
            f"{name}_target": np.zeros((STEPS + 1, 2)),
            f"{name}_q": rng.normal(size=(STEPS + 1, segments)),
            f"{name}_wave_torque": rng.normal(size=(STEPS, segments)),
            f"{name}_status": np.full(STEPS, int(name not in {"baseline", "nmpc"})),
            f"{name}_source": np.zeros(STEPS, int),
        }
    return found


def computed(experiment, parameters):
    """Arrays of all its runs, for real."""
    return {run.name: run.compute(run.parameters) for run in experiment.runs(parameters)}


def shelf(tables, arrays=None):
    """A store that has these, the tables as they are written and read again."""
    return SimpleNamespace(
        load_run=lambda run: arrays[run.name],
        read_table=lambda stem: read_table(StringIO(table_text(tables[stem]))),
    )


def tabulated(experiment, parameters, segments=3):
    """Tables of invented runs, also as the figures read them."""
    arrays = {run.name: invented(run, segments) for run in experiment.runs(parameters)}
    tables = experiment.tabulate(parameters, arrays)
    return tables, shelf(tables)
