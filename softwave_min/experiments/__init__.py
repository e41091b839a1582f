"""The experiments, by name.

An experiment's name is the stem of its module, of its results folder and of its
figure module.
"""

from __future__ import annotations

from importlib import import_module

from softwave_min.experiments.experiment import Experiment

__all__ = ["NAMES", "Experiment", "experiment"]

NAMES = (
    "spectra",
    "example_case",
    "error_ratio",
    "setpoints",
    "actuator_failure",
    "star",
    "star_drag",
    "random_seas",
    "ablations",
    "open_points",
    "star_sweep",
)


def experiment(name: str) -> Experiment:
    """Look an experiment up.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    if name not in NAMES:
        raise KeyError(f"no experiment {name!r}; there are: {', '.join(NAMES)}")
    found: Experiment = import_module(f"softwave_min.experiments.{name}").EXPERIMENT
    return found
