"""What each part is worth: the variants do what they say, and the tables say what they did."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest
from invented_loops import shelf
from segments import with_segments

from softwave_min.arm import pack_flow
from softwave_min.experiments import ablations, closed_loop
from softwave_min.experiments.ablation_loops import BASELINE, NMPC, loop_of, varied
from softwave_min.experiments.ablations import (
    HORIZONS,
    POSE_PAIRS,
    SEAS,
    half_grid,
    integral_gain,
    pose_ablations,
    runs,
    star_ablations,
    tabulate,
)
from softwave_min.experiments.star_path import StarParameters
from softwave_min.experiments.zero_order_hold import hold_flow, simulate_with_hold
from softwave_min.figures.ablations import draw
from softwave_min.paper.cases import poses, wave_cases
from softwave_min.runs.identity import as_plain
from softwave_min.simulation import BaselineController, root_mean_square_error, simulate

STEPS = 200


def scenario_of(nominal, *changes, duration=25.0, seed=1):
    parameters = varied(nominal, (("simulation.duration", duration), ("sea.seed", seed), *changes))
    return closed_loop.scenario_of(closed_loop.LoopRun(parameters, (poses()["P3"],)))


def in_current(nominal, velocity, *changes, duration=60.0):
    """P3 in a steady uniform flow with the components ``velocity``, and no noise."""
    quiet = (("preview.noise", "none"), ("sea.significant_height", 0.0))
    scenario = scenario_of(nominal, *quiet, *changes, duration=duration)
    structure = scenario.arm.structure
    flow = np.zeros((structure.space_order + 1, structure.time_order + 1), complex)
    flow[0, 0] = complex(*velocity)
    return replace(scenario, flow=np.tile(pack_flow(flow), (len(scenario.flow), 1)))


def offset(scenario):
    return simulate(scenario, "baseline").error[-1]


def settled(loop):
    return root_mean_square_error(loop.error[len(loop.error) // 2 :])


def median_error(nominal, seeds, *changes, run=lambda scenario: simulate(scenario, "nmpc")):
    """Over the seas of these seeds."""
    return np.median([settled(run(scenario_of(nominal, *changes, seed=seed))) for seed in seeds])


# --- fairer opponents -------------------------------------------------------------------

INTEGRAL, FEEDFORWARD = ("baseline.integral_gain", 0.35), ("baseline.load_feedforward", True)
CURRENTS = [(0.0, 0.3), (0.3, 0.0), (0.0, -0.3)]


@pytest.mark.parametrize("current", CURRENTS)
def test_the_integral_action_removes_the_offset_in_a_steady_current(nominal, current):
    plain = offset(in_current(nominal, current))
    assert plain > 5e-3
    assert offset(in_current(nominal, current, INTEGRAL)) < 1e-4 * plain


@pytest.mark.parametrize("current", CURRENTS)
def test_the_feedforward_cancels_a_steady_load(nominal, current):
    # On an arm that floats the spring about its command is linear, and nothing is left.
    floats = ("arm.density", (nominal.fluid.density,) * nominal.arm.segments)
    plain = offset(in_current(nominal, current, floats))
    assert offset(in_current(nominal, current, floats, FEEDFORWARD)) < 1e-4 * plain


def test_what_the_feedforward_leaves_on_a_heavy_arm_is_of_second_order(nominal):
    heavy = ("arm.density", (1200.0,) * nominal.arm.segments)
    plain, rest = [], []
    for factor in (1.0, 2.0):  # of the load, which goes with the square of the speed
        current = (0.0, -0.3 * np.sqrt(factor))
        plain.append(offset(in_current(nominal, current, heavy)))
        rest.append(offset(in_current(nominal, current, heavy, FEEDFORWARD)))
    assert rest[1] < 0.1 * plain[1]
    assert plain[1] / plain[0] == pytest.approx(2.0, rel=0.2)
    assert rest[1] / rest[0] == pytest.approx(4.0, rel=0.3)


def test_the_gain_is_that_of_the_magnitude_optimum(nominal):
    current, gain = (0.0, 0.3), integral_gain(nominal)
    plain = in_current(nominal, current)
    home = simulate(plain, "baseline").tips[-1, -1] - plain.targets[0]

    def undershoot(factor):
        """Largest offset to the far side, of that without integral action."""
        integral = ("baseline.integral_gain", factor * gain)
        tips = simulate(in_current(nominal, current, integral), "baseline").tips[:, -1]
        along = (tips - plain.targets[0]) @ home / (home @ home)
        return -along[len(along) // 4 :].min()

    # A damping of 1/sqrt(2) overshoots by 4 %; much gain by more, little gain not at all.
    assert undershoot(0.25) < 0.002 < undershoot(4.0)
    assert undershoot(1.0) < 0.05 < undershoot(8.0)


def test_in_waves_the_feedforward_helps_and_the_integral_action_does_not(nominal):
    gain = ("baseline.integral_gain", integral_gain(nominal))
    for seed in (1, 2, 3):
        plain, integral, feedforward = (
            settled(simulate(scenario_of(nominal, *more, duration=60.0, seed=seed), "baseline"))
            for more in ((), (gain,), (FEEDFORWARD,))
        )
        assert feedforward < 0.3 * plain
        assert integral > 0.9 * plain


def test_the_corrections_run_the_same_stepped_and_asked_for_by_name(nominal):
    scenario = scenario_of(nominal, INTEGRAL, FEEDFORWARD, duration=3.0)
    named, stepped = (simulate(scenario, one) for one in ("baseline", BaselineController(scenario)))
    np.testing.assert_array_equal(named.q, stepped.q)
    plain = simulate(scenario_of(nominal, duration=3.0), "baseline")
    assert np.abs(named.q - plain.q).max() > 1e-3


def test_the_feedforward_knows_no_more_than_it_is_told(nominal):
    untold = (("preview.waves", False), ("preview.noise", "none"))
    plain, fed = (
        simulate(scenario_of(nominal, *untold, *more, duration=5.0), "baseline")
        for more in ((), (FEEDFORWARD,))
    )
    np.testing.assert_allclose(fed.q, plain.q, atol=1e-9)
    # It looks at the present alone: a later flow does not change the command.
    scenario = scenario_of(nominal, FEEDFORWARD, ("preview.noise", "none"), duration=5.0)
    later = scenario.flow.copy()
    later[21:] = 0.0
    changed = replace(scenario, flow=later)
    a, b = (BaselineController(one).command(20, one.initial_state) for one in (scenario, changed))
    np.testing.assert_array_equal(a.q_bar, b.q_bar)


# --- what the NMPC is told --------------------------------------------------------------


def test_holding_the_flow_is_exact_where_it_does_not_change(nominal):
    scenario = in_current(nominal, (0.2, 0.2), duration=3.0)
    held = simulate_with_hold(scenario, hold_flow)
    np.testing.assert_allclose(held.q, simulate(scenario, "nmpc").q, atol=1e-8)


def test_each_step_of_knowledge_lowers_the_error(nominal):
    of = {
        one.name: median_error(nominal, (1, 2, 3), *one.changes, run=partial(loop_of, ablation=one))
        for one in pose_ablations(nominal)
        if one.name in {"preview_exact", "preview_present", "preview_none"}
    }
    assert of["preview_exact"] < 0.8 * of["preview_present"] < 0.8 * of["preview_none"]


def test_a_longer_horizon_helps_until_the_arm_forgets(nominal):
    errors = np.array([median_error(nominal, (1, 2), ("nmpc.horizon", K)) for K in HORIZONS])
    assert errors[0] > 1.5 * errors[1]
    assert np.all(errors[1:] < 1.03 * errors[:-1])  # never worse, but for scatter
    assert errors[-1] > 0.9 * errors[-2]


# --- the variants and the grid ----------------------------------------------------------


def test_a_variant_changes_what_it_names_and_nothing_else(nominal):
    plain = as_plain(nominal)
    for ablation in (*pose_ablations(nominal), *star_ablations(nominal)):
        named = {field for field, _ in ablation.changes}
        other = as_plain(varied(nominal, ablation.changes))
        changed = {
            f"{section}.{name}"
            for section, fields in plain.items()
            for name, value in fields.items()
            if other[section][name] != value
        }
        assert changed == named
        as_it_is = ablation.flow_on_hold or ablation.name in {NMPC, BASELINE, "period_1"}
        assert (not named) == as_it_is
    names = [ablation.name for ablation in pose_ablations(nominal)]
    assert len(set(names)) == len(names)
    assert {ablation.rival for ablation in pose_ablations(nominal)} <= set(names)


def test_slow_control_looks_as_far_ahead_and_weighs_the_same(nominal):
    for ablation in star_ablations(nominal):
        one, was = varied(nominal, ablation.changes).nmpc, nominal.nmpc
        assert one.horizon * one.control_period == pytest.approx(was.horizon * was.control_period)
        assert one.control_period / one.substeps == pytest.approx(was.control_period / was.substeps)
        assert one.step_weight * one.control_period**2 == pytest.approx(
            was.step_weight * was.control_period**2
        )


def test_the_half_grid_is_balanced(nominal):
    found = list(half_grid(nominal))
    seas = {(one.wave, one.height, one.seed) for one in found}
    assert len(seas) == len(wave_cases()) * len(ablations.HEIGHTS) * SEAS
    assert len(found) == 2 * len(seas) == len({one.run_name() for one in found})
    x, z = (dict(zip(poses(), axis, strict=True)) for axis in zip(*poses().values(), strict=True))
    for near, far in POSE_PAIRS:
        assert x[near] < x[far]
        assert z[near] != z[far]
    for pose in ("P1", "P3", "P4", "P6"):
        mine = [one for one in found if one.pose == pose]
        every = set(product(wave_cases(), ablations.HEIGHTS))
        assert {(one.wave, one.height) for one in mine} == every
        assert abs(len(mine) - len(found) / 4) <= 1
    assert {one.parameters.preview.seed for one in found} == {
        nominal.preview.seed + k for k in range(SEAS)
    }


# --- tables and figures -----------------------------------------------------------------

LEVEL = {NMPC: 1.0, BASELINE: 4.0, "baseline_feedforward": 0.5, "preview_none": 3.0}


def series(run):
    """Made-up arrays: constant errors, larger in the start and in other seas alike."""
    sea = run.parameters.parameters.sea
    found = {}
    for ablation in run.parameters.ablations:
        level = LEVEL.get(ablation.name, 2.0) * sea.significant_height * (1 + sea.seed)
        if isinstance(run.parameters.target, StarParameters):
            level *= sea.peak_period
        error = np.full(STEPS + 1, level)
        error[:3] = 50.0
        found |= {f"{ablation.name}_error": error}
        found |= {f"{ablation.name}_{name}": np.zeros(STEPS, int) for name in ("status", "source")}
    return found


@pytest.fixture(scope="module")
def tables(nominal):
    arrays = {run.name: series(run) for run in runs(nominal)}
    arrays["W1-P1-050cm-1"]["preview_none_status"][7] = 1
    return tabulate(nominal, arrays)


def test_the_tables_compare_with_the_right_loops(nominal, tables):
    cells, summary = tables["ablations"], tables["summary"]
    assert len(cells) == len(pose_ablations(nominal)) * len(list(half_grid(nominal)))
    one = cells[cells.variant == "preview_none"].iloc[0]
    assert one.ratio_nmpc_settled == pytest.approx(3.0)
    assert one.ratio_baseline_settled == pytest.approx(0.75)
    assert one.ratio_nmpc < 3.0  # the start is in it
    assert cells.solves_failed.sum() == 1
    found = summary[summary.window == "settled"].set_index("variant")
    assert found.ratio["preview_none"] == pytest.approx(3.0)
    assert found.against["preview_none"] == pytest.approx(0.75)
    assert found.ratio["baseline_feedforward"] == pytest.approx(0.125)  # of the baseline's
    assert found.against["baseline_feedforward"] == pytest.approx(2.0)  # NMPC over it
    assert found.order["baseline_feedforward"] == 0.0
    assert found.order["baseline_integral"] == 1.0
    assert found.rival["textbook_nmpc"] == "textbook_baseline"
    assert found.against["textbook_nmpc"] == pytest.approx(1.0)
    assert (found.ratio_low <= found.ratio).all()
    assert set(tables["by_height"].Hs) == set(ablations.HEIGHTS)


def test_the_range_over_the_periods_is_that_of_each_sea(tables):
    spreads = tables["spreads"]
    periods = np.array([case.peak_period for case in wave_cases().values()])
    expected = np.ptp(periods) / periods.mean()
    settled_rows = spreads[spreads.window == "settled"]
    np.testing.assert_allclose(settled_rows.spread[settled_rows.control_period < 0.2], expected)
    assert (spreads.spread_least <= spreads.spread).all()


@pytest.mark.parametrize("segments", [2, 4, 5])
def test_arms_of_any_number_of_segments_have_ablations(nominal, segments):
    short = varied(with_segments(nominal, segments), (("simulation.duration", 0.3),))
    first, *_, last = runs(short)
    for run in (first, last):
        found = run.compute(run.parameters)
        for ablation in run.parameters.ablations:
            assert np.isfinite(found[f"{ablation.name}_error"]).all()
    made_up = {run.name: series(run) for run in runs(short)}
    assert not tabulate(short, made_up)["summary"].isna().any(axis=None)


def test_every_figure_says_how_many_solves_failed(nominal, tables):
    drawings = draw(shelf(tables), nominal)
    assert set(drawings) == {"ablations", "horizon_and_delay", "opponents", "control_speed"}
    assert "did not converge: 1;" in drawings["ablations"].caption
    assert "Every solve converged" in drawings["control_speed"].caption
