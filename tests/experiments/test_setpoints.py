"""Postures at rest, what they reach, and the experiment `setpoints`."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from invented_loops import shelf

from softwave_min.arm import Arm
from softwave_min.experiments.ablation_loops import varied
from softwave_min.experiments.failures import failure_cases
from softwave_min.experiments.resting_arm import (
    REACHED,
    RestingArm,
    RestRun,
    area,
    at_rest,
    nearest_posture,
    reach,
    workspace,
)
from softwave_min.experiments.setpoints import EXPERIMENT
from softwave_min.figures.setpoints import draw, outlines
from softwave_min.figures.style import svg
from softwave_min.paper.cases import poses
from softwave_min.parameters import parameter_set

BOUND = math.pi
CASES = failure_cases(parameter_set())


@pytest.fixture(scope="module")
def arm(nominal):
    return Arm(nominal.arm, nominal.fluid)


def resting(nominal, case):
    return RestingArm(Arm(nominal.arm, nominal.fluid), CASES[case].of(nominal).failure)


def angles_of(case, count=200, bound=BOUND):
    m = 3 if case == "intact" else 2
    return np.random.default_rng(5).uniform(-bound, bound, (count, m))


@pytest.mark.parametrize("case", ["mid_passive", "tip_passive"])
def test_a_passive_segment_hangs_in_equilibrium(nominal, arm, case):
    failed = CASES[case].segment - 1
    q = resting(nominal, case).postures(angles_of(case))
    row = arm.gravity_vector(q)[:, failed] + arm.stiffness_vector(q)[:, failed]
    np.testing.assert_allclose(row, 0, atol=1e-10)
    assert np.abs(q[:, failed]).max() > 1e-3


def test_a_passive_segment_sags_down_by_its_weight(nominal):
    """To first order in the weight, from the straight horizontal arm: k q = -dV/dq."""
    own, fluid = nominal.arm, nominal.fluid
    length, diameter = own.length[2], own.diameter[2]
    weight = fluid.gravity * (own.density[2] - fluid.density) * math.pi / 4 * diameter**2 * length
    hanging = resting(nominal, "tip_passive").postures(np.zeros(2))[2]
    assert hanging == pytest.approx(-weight * length / 6 / own.stiffness[2], rel=2e-3)


def test_without_weight_passive_and_locked_are_one(nominal):
    floating = varied(nominal, (("arm.density", (nominal.fluid.density,) * 3),))
    angles = angles_of("mid_passive")
    one, other = (resting(floating, f"mid_{manner}") for manner in ("passive", "locked"))
    np.testing.assert_allclose(one.postures(angles), other.postures(angles), atol=1e-12)


def test_a_passive_segment_without_stiffness_is_refused(nominal):
    limp = replace(nominal.arm, stiffness=(1.0, 0.0, 1.0))
    failure = CASES["mid_passive"].of(nominal).failure
    with pytest.raises(ValueError, match="without stiffness"):
        RestingArm(Arm(limp, nominal.fluid), failure)


@pytest.mark.parametrize("case", CASES)
def test_postures_hold_what_is_chosen_and_tips_follow(nominal, arm, case):
    angles, failed = angles_of(case), CASES[case].segment
    one = resting(nominal, case)
    q = one.postures(angles)
    kept = np.delete(q, failed - 1, axis=1) if failed else q
    np.testing.assert_array_equal(kept, angles)
    np.testing.assert_allclose(one.tips(angles), arm.tip(q), atol=1e-14)


@pytest.mark.parametrize("case", CASES)
def test_the_jacobian_is_that_of_the_tip_at_rest(nominal, case):
    one, width = resting(nominal, case), 1e-6
    for angles in angles_of(case, count=5):
        moved = width * np.eye(len(angles))
        slope = (one.tips(angles + moved) - one.tips(angles - moved)).T / (2 * width)
        np.testing.assert_allclose(one.jacobian(angles), slope, atol=1e-8)


@pytest.mark.parametrize("case", CASES)
def test_what_is_reached_by_forward_kinematics_is_reached_by_least_squares(nominal, arm, case):
    one = resting(nominal, case)
    starts = angles_of(case, count=12)
    for angles in angles_of(case, count=5, bound=0.8 * BOUND):
        posture, left = nearest_posture(one, BOUND, one.tips(angles), starts)
        assert left < 1e-6
        np.testing.assert_allclose(arm.tip(posture), one.tips(angles), atol=1e-6)


def test_what_is_left_of_a_far_target_is_its_distance_to_the_straight_arm(nominal):
    base, length = np.array(nominal.arm.base_position), sum(nominal.arm.length)
    for case in ("intact", "mid_locked"):
        one = resting(nominal, case)
        target = base + np.array([length + 0.4, 0.0])
        starts = angles_of(case, count=4, bound=0.5)
        posture, left = nearest_posture(one, BOUND, target, starts)
        assert left == pytest.approx(0.4, abs=1e-6)
        np.testing.assert_allclose(posture, 0, atol=1e-2)


def test_a_failed_arm_reaches_no_more_than_the_intact_one(nominal):
    """Its postures are postures of the intact arm, within the bound."""
    bound = 0.6 * BOUND
    whole = resting(nominal, "intact")
    for case in ("mid_passive", "tip_passive", "mid_locked", "tip_locked"):
        failed = resting(nominal, case)
        for angles in angles_of(case, count=4, bound=bound):
            q = failed.postures(angles)
            assert np.abs(q).max() <= bound
            _, left = nearest_posture(whole, bound, failed.tips(angles), q[None])
            assert left < 1e-9


def test_maps_shrink_with_actuation_and_with_the_bound(nominal):
    cell = 0.03
    whole = workspace(resting(nominal, "intact"), BOUND, cell)
    failed = workspace(resting(nominal, "mid_locked"), BOUND, cell)
    narrow = workspace(resting(nominal, "intact"), BOUND / 2, cell)
    for smaller in (failed, narrow):
        outside = np.count_nonzero(smaller & ~whole)
        assert outside <= 0.003 * np.count_nonzero(whole)  # cells that samples just miss
        assert area(smaller, cell)[0] < 0.9 * area(whole, cell)[0]


def test_the_map_of_two_angles_is_that_of_the_forward_kinematics(nominal):
    cell = 0.02
    one = resting(nominal, "mid_passive")
    cells = workspace(one, BOUND, cell)
    base, half = np.array(nominal.arm.base_position), len(cells) // 2
    column, row = np.floor((one.tips(angles_of("mid_passive", 2000)) - base) / cell).astype(int).T
    assert cells[column + half, row + half].mean() > 0.999


def test_the_reach_of_one_free_angle_has_no_area(arm):
    """Of an arm that can only turn its last segment the tip draws a curve: what is
    counted falls with the cell, where an area would not."""
    bends = np.linspace(-BOUND, BOUND, 4001)
    tips = arm.tip(np.stack([0 * bends, 0 * bends, bends], axis=1))
    sizes = []
    for cell in (0.02, 0.01, 0.005):
        column, row = np.floor((tips - tips.min(axis=0)) / cell).astype(int).T + 1
        cells = np.zeros((column.max() + 2, row.max() + 2), dtype=bool)
        cells[column, row] = True
        size, error = area(cells, cell)
        assert size <= 1.1 * error
        sizes.append(size)
    assert sizes[2] < 0.6 * sizes[1] < 0.36 * sizes[0]


def test_the_area_of_a_disc():
    cell = 0.01
    offsets = cell * (np.arange(240) + 0.5 - 120)
    cells = offsets[:, None] ** 2 + offsets**2 < 1
    size, error = area(cells, cell)
    assert abs(size - math.pi) < error
    assert error == pytest.approx(cell * 8 / math.sqrt(2) / 2, rel=0.05)


@pytest.fixture(scope="module")
def arrays(nominal):
    """The kinematics as the experiment has them, the closed loops cut short."""
    found = {
        run.name: reach(run.parameters)
        for run in EXPERIMENT.runs(nominal)
        if run.name.startswith("reach")
    }
    short = varied(nominal, (("sea.significant_height", 0.0), ("simulation.duration", 4.0)))
    loop = at_rest(RestRun(CASES["mid_passive"].of(short), tuple(poses().values())))
    return {**found, **{f"rest-{case}": loop for case in CASES}}


@pytest.fixture(scope="module")
def tables(nominal, arrays):
    return EXPERIMENT.tabulate(nominal, arrays)


def test_the_intact_arm_reaches_every_pose_and_the_failed_one_not(tables):
    table = tables["setpoints"]
    assert list(zip(table["case"], table["pose"], strict=True)) == list(product(CASES, poses()))
    assert (table["reachable"] == (table["distance_left"] < REACHED)).all()
    reached = table.groupby("case")["reachable"].sum()
    assert reached["intact"] == len(poses())
    assert reached["mid_locked"] < len(poses())


def test_no_posture_of_the_controller_beats_the_least_squares(tables, arrays):
    mid = tables["setpoints"].query("case == 'mid_passive'")
    rest = arrays["rest-mid_passive"]
    bounded = np.abs(np.delete(rest["q"], 1, axis=1)).max(axis=1) <= BOUND
    assert (mid["error"] >= mid["distance_left"] - 2e-3)[bounded].all()


def test_a_failed_solve_is_in_the_table(nominal, arrays):
    broken = {name: array.copy() for name, array in arrays["rest-tip_passive"].items()}
    broken["status"][2, 3] = 1
    broken["source"][2, 3:5] = 1
    found = EXPERIMENT.tabulate(nominal, {**arrays, "rest-tip_passive": broken})["setpoints"]
    (row,) = found[found["solves_failed"] + found["fallbacks"] > 0].itertuples()
    assert (row.case, row.pose, row.solves_failed, row.fallbacks) == ("tip_passive", "P3", 1, 2)


def test_shares_of_the_workspace(tables):
    table = tables["workspace"].set_index("case")
    assert table.loc["intact", "share"] == 1
    assert (table["share"].drop("intact") < 1).all()
    assert (table["area"] <= math.pi * 0.9**2).all()
    assert (table["resolution"] < 0.05 * table["area"]).all()


def test_waves_and_seeds_do_not_make_it_stale(nominal):
    def identities(*changes):
        return {run.name: run.identity for run in EXPERIMENT.runs(varied(nominal, changes))}

    first = identities()
    assert identities(("sea.significant_height", 1.0), ("sea.realisations", 4)) == first
    assert not set(identities(("nmpc.angle_bound", 2.0)).values()) & set(first.values())
    bare = identities(("nmpc.tip_weight", 50.0))
    assert all((bare[name] == first[name]) == name.startswith("reach") for name in first)


def test_outlines_have_the_arms_thickness(arm):
    for outline, diameter in zip(
        outlines(arm, np.array([0.5, -1.0, 2.0])), arm.parameters.diameter, strict=True
    ):
        left, right = np.split(outline, 2)
        width = np.linalg.norm(left - right[::-1], axis=1)
        np.testing.assert_allclose(width, diameter, rtol=1e-12)


def test_figures_mark_what_is_out_of_reach(nominal, arrays, tables):
    store = shelf(tables, arrays)
    drawings = draw(store, nominal)
    missed = tables["setpoints"].query("case == 'mid_passive' and not reachable")["pose"]
    texts = [text.get_text() for text in drawings["setpoints"].figure.axes[1].texts]
    for pose in missed:
        assert any(f"{pose} missed by" in text for text in texts)
    assert svg(drawings["setpoints"]) == svg(draw(store, nominal)["setpoints"])
    assert {*drawings} == {"setpoints", "workspace"}
