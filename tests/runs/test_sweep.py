"""Sweeps: by whom they are computed, interrupted, resumed and reported."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from toy_sweep import RUNS, Draw, nap, toy
from toy_sweep import compute as compute_sample

from softwave_min.data import ROOT
from softwave_min.parameters import parameter_set
from softwave_min.runs import store as stores
from softwave_min.runs import sweep
from softwave_min.runs.executor import Cluster, Processes, attempt, completed
from softwave_min.runs.experiment import Run
from softwave_min.runs.identity import run_identity
from softwave_min.runs.plan import Task
from softwave_min.runs.store import Store, read_table
from softwave_min.runs.sweep import SweepError, compute, compute_all

HELPERS = Path(__file__).resolve().parents[1] / "helpers"
KILLS = 10
PATIENCE = 20.0
"""Longest that anything here may take on a busy machine, in s."""


@pytest.fixture
def shelf(tmp_path):
    return Store("toy", tmp_path)


def table_bytes(folder: Path):
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.csv"))}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Tables of the toy's sweep in this process, run after run."""
    shelf = Store("toy", tmp_path_factory.mktemp("undisturbed"))
    with Processes(1) as workers:
        compute(toy(pause=0.0), parameter_set(), shelf, workers)
    return table_bytes(shelf.folder)


# --- who computes -----------------------------------------------------------------------


def test_tables_are_the_same_to_the_last_bit_whoever_computes_the_runs(shelf, undisturbed):
    with Processes(2) as workers:
        assert compute(toy(pause=0.0), parameter_set(), shelf, workers) == RUNS
    assert table_bytes(shelf.folder) == undisturbed


def test_runs_that_end_in_another_order_make_the_same_tables(shelf, undisturbed, monkeypatch):
    monkeypatch.setattr(sweep, "completed", lambda *given: reversed([*completed(*given)]))
    compute(toy(pause=0.0), parameter_set(), shelf, Processes(1))
    assert table_bytes(shelf.folder) == undisturbed


def test_a_sweep_on_a_dask_cluster_makes_the_same_tables(shelf, undisturbed, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.syspath_prepend(HELPERS)
    with (
        LocalCluster(
            host="127.0.0.1",
            protocol="tcp://",
            n_workers=1,
            threads_per_worker=2,
            processes=False,
            dashboard_address=None,
        ) as cluster,
        Cluster(cluster.scheduler_address) as workers,
    ):
        with pytest.raises(SweepError, match=r"1 of 3 runs failed.*s-1-0: a seed below zero"):
            compute(toy(seeds=(-1, 0, 1), pause=0.0), parameter_set(), shelf, workers)
        assert compute(toy(pause=0.0), parameter_set(), shelf, workers) == RUNS - 2
    assert table_bytes(shelf.folder) == undisturbed


def test_a_worker_with_another_source_computes_nothing():
    draw = toy(seeds=(1,)).runs(parameter_set())[0].parameters
    assert attempt(compute_sample, draw, run_identity(compute_sample, draw).digest).failure == ""
    assert "another source" in attempt(compute_sample, draw, "identity of older source").failure


def test_a_run_under_two_names_in_one_experiment_is_computed_once_and_has_two_rows(shelf):
    runs = [Run(name, compute_sample, Draw(1, 5, 0.0)) for name in "ab"]
    twice = replace(toy(pause=0.0), runs=lambda _: runs)
    assert compute(twice, parameter_set(), shelf, Processes(1)) == 1
    assert list(read_table(shelf.folder / "means.csv")["run"]) == ["a", "b"]


# --- failures ---------------------------------------------------------------------------


def test_the_runs_beside_a_failed_one_are_kept_and_the_report_is_a_line(shelf):
    with (
        Processes(2) as workers,
        pytest.raises(SweepError, match=r"^toy: 2 of 6 runs failed.* s-2-0: a seed below zero$"),
    ):
        compute(toy(seeds=range(-2, 4), pause=0.0), parameter_set(), shelf, workers)
    assert compute(toy(seeds=range(5), pause=0.0), parameter_set(), shelf, Processes(1)) == 1


def test_an_error_lets_the_workers_go_at_once():
    def interrupted():
        with Processes(2) as workers:
            for _ in completed(workers, time.sleep, [(0.0,), (1000.0,), (1000.0,)]):
                raise KeyboardInterrupt

    started = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert time.perf_counter() - started < PATIENCE


def test_what_is_submitted_later_is_done_before_what_is_still_to_be_handed_out(tmp_path):
    naps = [(tmp_path / "naps", 0.01)] * 60
    with Processes(2) as workers:
        urgent = None
        for _ in completed(workers, nap, naps):
            urgent = urgent or workers.submit(nap, tmp_path / "urgent", 0.0)
            if urgent.done():
                break
    assert (tmp_path / "naps").stat().st_size < len(naps)


def test_a_dead_worker_fails_the_call_that_killed_it_and_no_other(tmp_path):
    calls = [(tmp_path / "naps", 0.05)] * 9
    calls[3] = (None, 0.05)  # it dies
    with Processes(2) as workers:
        failed = [index for index, done in completed(workers, nap, calls) if done.exception()]
        assert failed == [3]
        alive = [done.result() for _, done in completed(workers, abs, [(-1,), (-2,)])]
    assert sorted(alive) == [1, 2]


def test_an_error_in_the_tables_of_one_experiment_leaves_the_others_alone(tmp_path):
    toys = toy(range(3), 0.0)
    wrong = replace(renamed(toys, "wrong"), tabulate=lambda *_: {"ratio": 1 / 0})
    swept = shared_sweep(wrong, toys, tmp_path, Processes(1))
    assert [one.failure for one in swept] == [
        "wrong: the tables failed, the runs are kept: division by zero", ""
    ]  # fmt: skip
    assert table_bytes(tmp_path / "toy")
    assert not list((tmp_path / "wrong").glob("*.*"))


# --- interruptions ----------------------------------------------------------------------


class Death(BaseException):
    """Ends a process here without a chance to clean up."""


def test_a_death_at_any_write_changes_nothing_in_the_end(tmp_path, monkeypatch):
    experiment, parameters = toy(seeds=range(3), pause=0.0), parameter_set()
    compute(experiment, parameters, Store("toy", tmp_path / "whole"), Processes(1))
    whole = table_bytes(tmp_path / "whole" / "toy")
    replace, unlink = os.replace, os.unlink

    def dies_at(write, before):
        left = iter(range(write, -1, -1))

        def replaced(source, target):
            remaining = next(left)
            if remaining == 0 and before:
                raise Death
            replace(source, target)
            if remaining == 0:
                raise Death

        return replaced

    deaths = 0
    for write in range(100):
        for before in (True, False):
            shelf = Store("toy", tmp_path / f"{write}-{before}")
            monkeypatch.setattr(stores.os, "unlink", lambda _: None)
            monkeypatch.setattr(stores.os, "replace", dies_at(write, before))
            with contextlib.suppress(Death):
                compute(experiment, parameters, shelf, Processes(1))
                assert deaths == 2 * 12  # three runs of two files, twice two tables and one record
                return
            deaths += 1
            monkeypatch.setattr(stores.os, "replace", replace)
            monkeypatch.setattr(stores.os, "unlink", unlink)
            compute(experiment, parameters, shelf, Processes(1))
            assert table_bytes(shelf.folder) == whole
            assert not any(name.startswith(".writing-") for name in shelf.provenance()["files"])


def test_what_dead_writers_leave_is_cleared_away(shelf):
    old, new = shelf.folder / ".writing-old", shelf.root / "runs" / ".writing-new"
    for path in (old, new):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"half a ta")
    os.utime(old, (0, 0))
    compute(toy(seeds=range(2), pause=0.0), parameter_set(), shelf, Processes(1))
    assert not old.exists()
    assert new.exists()  # another sweep may be writing it


@pytest.fixture
def sweeps(tmp_path):
    """A server of sweeps into a folder: arguments in, process id and exit status out."""
    server = subprocess.Popen(
        [sys.executable, "-c", "import toy_sweep; toy_sweep.serve()"],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(HELPERS), str(ROOT)]),
            "SOFTWAVE_RESULTS": str(tmp_path),
            "OPENBLAS_NUM_THREADS": "1",  # threads do not survive a fork
            "PYTHONWARNINGS": "ignore",
        },
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )

    def answer(word):
        """What follows the word on the next line that begins with it; sweeps print, too."""
        for line in server.stdout:
            first, _, rest = line.strip().partition(" ")
            if first == word:
                return rest
        raise AssertionError("the server of sweeps has ended")

    def start(*arguments):
        print(*arguments, file=server.stdin, flush=True)
        return psutil.Process(int(answer("process")))

    answer("ready")
    yield start, lambda: int(answer("status"))
    server.kill()
    server.communicate()


def test_a_sweep_killed_ten_times_ends_with_the_tables_of_an_undisturbed_one(
    tmp_path, sweeps, undisturbed
):
    start, status = sweeps
    shelf = Store("toy", tmp_path)
    runs = toy().runs(parameter_set())
    random = np.random.default_rng(2401)
    killed_at_work = 0
    for kill in range(KILLS):
        killed = start("run", "--jobs", 1 if kill % 8 == 1 else 2)  # here, or by workers
        present = computed(shelf)
        while kill % 2 and computed(shelf) == present:  # every second one when it is at work
            time.sleep(0.005)
        time.sleep(random.uniform(0.0, 0.15))
        family = [killed, *killed.children(recursive=True)]
        if kill % 4 < 2:
            os.killpg(killed.pid, signal.SIGKILL)
        else:
            killed.kill()
        assert status() == -signal.SIGKILL
        assert not psutil.wait_procs(family, timeout=PATIENCE)[1]  # workers end as well
        killed_at_work += computed(shelf) > present
        readable(shelf, runs)
    assert killed_at_work >= KILLS // 2
    assert computed(shelf) < len(runs)
    start("run", "--jobs", 1)
    assert status() == 0
    assert table_bytes(shelf.folder) == undisturbed
    assert all(shelf.has(run) for run in runs)
    assert shelf.provenance()


def computed(shelf):
    return sum(1 for _ in shelf.root.glob("runs/*.npz"))


def readable(shelf, runs):
    """Whatever counts as there is whole."""
    for run in runs:
        if shelf.has(run):
            np.testing.assert_array_equal(
                shelf.load_run(run)["sample"], compute_sample(run.parameters)["sample"]
            )
    for path in shelf.folder.glob("*.csv"):
        assert isinstance(read_table(path), pd.DataFrame)


# --- runs that two experiments share ----------------------------------------------------


def renamed(experiment, name):
    """Another experiment of the same runs, under other names."""

    def runs(parameters):
        return [replace(run, name=f"other-{run.name}") for run in experiment.runs(parameters)]

    return replace(experiment, name=name, runs=runs)


def test_what_an_experiment_beside_has_computed_is_not_computed_again(tmp_path):
    experiment, parameters = toy(seeds=range(4), pause=0.0), parameter_set()
    other = renamed(toy(seeds=range(5), pause=0.0), "other")
    alone, shelf = Store("other", tmp_path / "alone"), Store("other", tmp_path / "shared")
    assert compute(other, parameters, alone, Processes(1)) == 5
    compute(experiment, parameters, Store("toy", tmp_path / "shared"), Processes(1))
    assert compute(other, parameters, shelf, Processes(1)) == 1
    assert table_bytes(shelf.folder) == table_bytes(alone.folder)
    assert all(shelf.has(run) for run in other.runs(parameters))


def test_only_whole_runs_of_the_same_definition_are_taken_over(tmp_path):
    experiment, parameters = toy(seeds=range(4), pause=0.0), parameter_set()
    beside = Store("toy", tmp_path)
    compute(experiment, parameters, beside, Processes(1))
    half, foreign, gone, _ = (beside.run_path(run) for run in experiment.runs(parameters))
    half.write_bytes(half.read_bytes()[:-1])
    foreign.write_bytes(gone.read_bytes())
    gone.with_suffix(".json").unlink()
    other = renamed(experiment, "other")
    assert compute(other, parameters, Store("other", tmp_path), Processes(1)) == 3


def shared_sweep(first, second, folder, workers):
    """Both experiments in one sweep; what it says of each, in the order in which it does."""
    return list(compute_all(tasks(folder, first, second), workers))


def tasks(folder, *experiments):
    return [Task(one, parameter_set(), Store(one.name, folder)) for one in experiments]


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_two_experiments_of_a_sweep_share_is_computed_once(tmp_path, jobs):
    parameters = parameter_set()
    toys, others = (toy(range(count), 0.0) for count in (4, 5))
    others = renamed(others, "other")
    alone = Store("other", tmp_path / "alone")
    compute(others, parameters, alone, Processes(1))
    with Processes(jobs) as workers:
        swept = shared_sweep(toys, others, tmp_path / "both", workers)
    assert [(one.task.experiment.name, one.computed) for one in swept] == [("toy", 4), ("other", 1)]
    shelf = Store("other", tmp_path / "both")
    assert table_bytes(shelf.folder) == table_bytes(alone.folder)
    assert all(shelf.has(run) for run in others.runs(parameters))


def test_a_failed_run_that_two_experiments_share_is_reported_by_both(tmp_path):
    toys = toy(range(-1, 2), 0.0)
    swept = shared_sweep(toys, renamed(toys, "other"), tmp_path, Processes(1))
    assert [one.failure.partition(";")[0].partition(",")[0] for one in swept] == [
        "toy: 1 of 3 runs failed",
        "other: 1 of 3 runs failed",
    ]
    assert not list(tmp_path.glob("*/*.csv"))


def test_an_experiment_has_its_tables_before_the_next_is_computed(tmp_path):
    toys, others = toy(range(3), 0.0), renamed(toy(range(10, 13), 0.0), "other")
    shelf = Store("other", tmp_path)
    swept = compute_all(tasks(tmp_path, toys, others), Processes(1))
    assert next(swept).task.experiment is toys
    assert table_bytes(tmp_path / "toy")
    assert not any(shelf.has(run) for run in others.runs(parameter_set()))
    assert next(swept).task.experiment is others
