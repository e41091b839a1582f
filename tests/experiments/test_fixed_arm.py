"""The experiment `fixed_arm`: loads of the water on an arm that does not move."""

from dataclasses import replace

import numpy as np
import pytest
from invented_loops import computed, shelf

from softwave_min.arm import Arm
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.fixed_arm import EXPERIMENT, peak_wave_number
from softwave_min.experiments.fixed_arm_loads import FixedArm, fixed_arm_loads
from softwave_min.figures.fixed_arm import draw
from softwave_min.figures.style import svg
from softwave_min.paper.cases import poses
from softwave_min.parameters import parameter_set
from softwave_min.waves import Sea

RISES = (0.6, 0.0, -2.4)


def loads(parameters, **sea):
    changed = replace(parameters, sea=replace(parameters.sea, **sea))
    return fixed_arm_loads(FixedArm(changed, tuple(poses().values()), RISES))


@pytest.fixture(scope="module")
def parameters():
    return varied(parameter_set(), (("simulation.duration", 12.0),))


@pytest.fixture(scope="module")
def in_w3(parameters):
    return loads(parameters, peak_period=10.0, significant_height=2.0)


def test_the_fixed_arm_is_at_the_pose(parameters, in_w3):
    tips = Arm(parameters.arm, parameters.fluid).tip(in_w3["angles"])
    # 12 s of planning at K_e = 2 /s, damped near the straight arm
    np.testing.assert_allclose(tips, list(poses().values()), atol=1e-3)


def test_drag_grows_with_the_square_of_the_height(parameters, in_w3):
    assert parameters.fluid.morison == "paper"  # no load but drag on an fixed arm
    half = loads(parameters, peak_period=10.0, significant_height=1.0)
    np.testing.assert_allclose(in_w3["torque"], 4 * half["torque"], rtol=1e-9)
    np.testing.assert_allclose(in_w3["speed"], 2 * half["speed"], rtol=1e-9)


def test_loads_fall_with_depth_as_the_water_slows(in_w3):
    torque = np.linalg.norm(in_w3["torque"], axis=2)
    assert np.all(np.diff(torque, axis=1) < 0)
    relative, speed = torque / torque[:, 1:2], in_w3["speed"] / in_w3["speed"][1]
    np.testing.assert_allclose(relative, np.tile(speed**2, (len(torque), 1)), rtol=0.08)


def test_speed_is_that_of_linear_theory_at_the_base(parameters, in_w3):
    sea = replace(parameters.sea, peak_period=10.0, significant_height=2.0)
    times = np.arange(0, parameters.simulation.duration, 0.4)
    u, w = Sea.random(sea, parameters.fluid.gravity).velocity(0.0, -6.4, times)
    assert in_w3["speed"][2] == pytest.approx(np.sqrt(np.mean(u**2 + w**2)), rel=1e-9)


def test_a_wave_much_longer_than_the_arm_is_uniform_about_it(parameters, in_w3):
    tide = loads(
        parameters, peak_period=900.0, lowest_frequency_hz=0.001, highest_frequency_hz=0.0013
    )
    np.testing.assert_allclose(
        np.linalg.norm(tide["torque_uniform"], axis=1),
        np.linalg.norm(tide["torque"][:, 1], axis=1),
        rtol=1e-2,
    )
    sea = np.linalg.norm(in_w3["torque"][:, 1], axis=1)
    varied = np.linalg.norm(in_w3["torque_uniform"], axis=1)
    assert np.all(np.abs(varied / sea - 1) < 0.5)
    assert np.any(np.abs(varied / sea - 1) > 0.02)


# --- the experiment ---------------------------------------------------------------------


@pytest.fixture(scope="module")
def tables(parameters):
    return EXPERIMENT.tabulate(parameters, computed(EXPERIMENT, parameters))


def test_a_row_for_each_pose_and_depth_beside_the_decay(parameters, tables):
    postures, depth = tables["postures"], tables["depth"]
    assert len(postures) == 3 * len(poses())
    here = depth[depth.z == parameters.arm.base_position[1]].reset_index(drop=True)
    assert (here.decay == 1).all()
    np.testing.assert_array_equal(here.torque, postures.torque)
    lowest = depth[(depth.wave == "W2") & (depth.z == depth.z.min())].iloc[0]
    number = peak_wave_number(varied(parameters, (("sea.peak_period", 8.0),)))
    assert lowest.decay == pytest.approx(np.exp(number * (lowest.z + 4.0)))
    assert depth.z.min() > -parameters.sea.depth + sum(parameters.arm.length)


def test_the_figure_is_the_same_bytes_again(parameters, tables):
    drawing = draw(shelf(tables), parameters)["loads"]
    assert svg(drawing) == svg(draw(shelf(tables), parameters)["loads"])
    assert len(drawing.figure.axes) == 2
