"""A planar soft arm in waves: the model, its controllers and the experiments.

What a reader needs to try an arm, a sea or a controller of their own is imported from here:

>>> import softwave_min as sw
>>> parameters = sw.load_parameters("calibrated")
>>> sea = sw.Sea.random(parameters.sea, parameters.fluid.gravity)
>>> sw.compare(parameters, sea, target=(0.7, -3.7)).errors()
RMSE of the tip, m  whole run  after 10 s
baseline ...
"""

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
