"""The experiments and the studies that are one, by name.

An experiment's name is the stem of its module, of its results folder and of its
figure module.
"""

from __future__ import annotations

from importlib import import_module

from softwave_min.runs.experiment import Experiment

MODULES = {
    "spectra": "experiments",
    "example_case": "experiments",
    "error_ratio": "experiments",
    "fixed_arm": "experiments",
    "setpoints": "experiments",
    "actuator_failure": "experiments",
    "star": "experiments",
    "star_drag": "experiments",
    "random_seas": "experiments",
    "ablations": "experiments",
    "open_points": "studies",
    "star_sweep": "experiments",
}
"""Room of each experiment's module."""
NAMES = tuple(MODULES)


def experiment(name: str) -> Experiment:
    """Look an experiment up.

    Raises
    ------
    KeyError
        If there is none of that name.
    """
    if name not in MODULES:
        raise KeyError(f"no experiment {name!r}; there are: {', '.join(NAMES)}")
    module = import_module(f"softwave_min.{MODULES[name]}.{name}")
    found: Experiment = module.EXPERIMENT
    return found
