"""An experiment of many short runs, and a server that starts its sweep over and over.

``serve`` takes a line of arguments from standard input for each sweep, forks, and lets
the copy run them as the command line would; it answers with the copy's process id, and when it
has ended with its exit status. So a sweep that is to be killed at once starts at once. Workers
import this module alone.
"""

from __future__ import annotations

import os
import sys
import time
import types
from dataclasses import dataclass

import numpy as np

RUNS = 150
PAUSE = 0.02
"""Duration of a run, in s."""


@dataclass(frozen=True)
class Draw:
    seed: int
    size: int
    pause: float


def compute(draw):
    time.sleep(draw.pause)
    if draw.seed < 0:
        raise ValueError("a seed\nbelow zero")
    return {"sample": np.random.default_rng(draw.seed).normal(size=draw.size)}


def die(_):
    """A run that takes its process along."""
    time.sleep(0.3)
    os._exit(1)


def nap(path, duration):
    """Sleep, and leave a mark in the file; without one, die."""
    time.sleep(duration)
    if path is None:
        os._exit(1)
    with path.open("a") as file:
        file.write(".")


def toy(seeds=range(RUNS), pause=PAUSE, **options):
    """The experiment: one random sample for each seed."""
    from softwave_min.runs.experiment import Experiment, Run

    return Experiment(
        name="toy",
        title="Random samples",
        claims=("C01", "C02", "C04"),
        runs=lambda parameters: [
            Run(f"s{seed}-{sea}", compute, Draw(seed + 1000 * sea, 2000, pause))
            for seed in seeds
            for sea in range(parameters.sea.realisations)
        ],
        tabulate=tables,
        **options,
    )


def tables(_, arrays):
    """A row for each run, in another table a number that depends on the order of the sum."""
    import pandas as pd

    total = 0.0
    for array in arrays.values():
        total = total * 0.999 + float(array["sample"].sum())
    means = {"run": list(arrays), "mean": [float(one["sample"].mean()) for one in arrays.values()]}
    return {"means": pd.DataFrame(means), "total": pd.DataFrame({"total": [total]})}


def install(*experiments):
    """Make these all the experiments that the command line knows; they draw nothing."""
    from softwave_min import commands

    known = {one.name: one for one in experiments}

    def experiment(name):
        if name not in known:
            raise KeyError(f"no experiment {name!r}; there are: {', '.join(known)}")
        return known[name]

    commands.NAMES = tuple(known)
    commands.experiment = experiment
    for name in known:
        figures = types.ModuleType(f"softwave_min.figures.{name}")
        figures.draw = lambda *_: {}
        sys.modules[figures.__name__] = figures


def serve():
    import matplotlib.pyplot as plt  # noqa: F401  what a sweep would import on its way

    from softwave_min.command_line import main

    install(toy())
    print("ready", flush=True)
    for line in sys.stdin:
        process = os.fork()
        if process == 0:
            os.setsid()  # so that it can be killed with its workers
            os._exit(main(line.split()))
        print("process", process, flush=True)
        print("status", os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]), flush=True)
