"""Energy of the undamped arm over ten seconds, in a vacuum and in still ideal water."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from arm_cases import UNEQUAL, WATER, acceleration_function, water

from softwave_min.arm import Arm

IDEAL = {"drag_coefficient": 0.0, "friction_coefficient": 0.0}


@pytest.mark.parametrize(
    "fluid",
    [replace(WATER, density=0.0), water("paper", **IDEAL), water("textbook", **IDEAL)],
    ids=["vacuum", "paper", "textbook"],
)
def test_energy_stays(fluid):
    """A swing through large bends, with weight, buoyancy, springs and rotary inertia."""
    arm = Arm(replace(UNEQUAL, damping=(0.0, 0.0, 0.0), quadrature_points=4), fluid)
    x = ca.SX.sym("x", 6)
    free = acceleration_function(arm.structure)(x[:3], x[3:], 0, arm.values, 0)
    problem = {"x": x, "ode": ca.cse(ca.vertcat(x[3:], free))}
    tight = {"reltol": 1e-12, "abstol": 1e-12, "max_num_steps": 10**6}
    swing = ca.integrator("swing", "cvodes", problem, 0, np.linspace(0, 10, 101), tight)
    path = swing(x0=[0.9, -1.7, 0.4, 0.0, 0.0, 3.0])["xf"].full().T
    kinetic = arm.kinetic_energy(*np.hsplit(path, 2))
    energy = kinetic + arm.potential_energy(path[:, :3])
    assert np.ptp(kinetic) > 1
    assert np.ptp(energy) < 1e-8 * np.ptp(kinetic)
