"""A planar soft arm in waves: the model, its controllers and the experiments.

What a reader needs to try an arm, a sea or a controller of their own is here:

>>> import softwave_min as sw
>>> parameters = sw.load_parameters("calibrated")
>>> sea = sw.Sea.random(parameters.sea, parameters.fluid.gravity)
>>> sw.compare(parameters, sea, target=(0.7, -3.7)).errors()
RMSE of the tip, m  whole run  after 10 s
baseline               0.2008      0.2140
nmpc                   0.0415      0.0188
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for editors; when the program runs, each is loaded when it is asked for
    from softwave_min.arm import Arm
    from softwave_min.parameters import ParameterSet, load_parameters
    from softwave_min.simulation import (
        CONTROLLERS,
        BaselineController,
        Command,
        Controller,
        NmpcController,
        Scenario,
        simulate,
    )
    from softwave_min.simulation.comparison import compare
    from softwave_min.waves import Sea, Spectrum
    from softwave_min.waves.records import measured_sea, read_spectrum

__all__ = [
    "CONTROLLERS",
    "Arm",
    "BaselineController",
    "Command",
    "Controller",
    "NmpcController",
    "ParameterSet",
    "Scenario",
    "Sea",
    "Spectrum",
    "compare",
    "load_parameters",
    "measured_sea",
    "read_spectrum",
    "simulate",
]
_ELSEWHERE = {
    "Arm": "arm",
    "ParameterSet": "parameters",
    "Sea": "waves",
    "Spectrum": "waves",
    "compare": "simulation.comparison",
    "load_parameters": "parameters",
    "measured_sea": "waves.records",
    "read_spectrum": "waves.records",
}
"""Rooms of the names that are not in ``simulation``."""


def __getattr__(name: str) -> Any:
    """Load what is asked for: who looks at waves alone need not know the controllers."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_ELSEWHERE.get(name, 'simulation')}"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
