"""Results on disk, and what identifies them."""

from __future__ import annotations

import io
import os
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import pytest

from softwave_min.data import read_toml
from softwave_min.paper.cases import wave_cases
from softwave_min.runs import identity, source
from softwave_min.runs.executor import Processes
from softwave_min.runs.experiment import Experiment, Run
from softwave_min.runs.identity import run_identity
from softwave_min.runs.plan import Freshness, Task
from softwave_min.runs.store import Store, read_table, table_text, tidy_runs, write_atomically
from softwave_min.runs.sweep import SweepError, compute, compute_all
from softwave_min.studies.catalogue import NAMES, experiment


@dataclass(frozen=True)
class Square:
    side: float


def area(square):
    if square.side < 0:
        raise ValueError("negative side")
    return {"area": np.array(square.side**2)}


def square(side, name="square"):
    return Run(name, area, Square(side))


def squares(*sides):
    """An experiment of one run per side."""
    return Experiment(
        name="squares",
        title="Squares",
        claims=(),
        runs=lambda _: [square(side, f"s{index}") for index, side in enumerate(sides)],
        tabulate=lambda _, runs: {
            "areas": pd.DataFrame({"area": [float(run["area"]) for run in runs.values()]})
        },
    )


@pytest.fixture
def shelf(tmp_path):
    return Store("squares", tmp_path)


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A package ``toy`` in place of ours: plant <- arm (with a C source); sea alone."""
    package = tmp_path / "toy"
    for name, text in {
        "__init__.py": "from toy.sea import wave\n",
        "plant.py": "import toy\nfrom toy.arm import mass\n",
        "sea.py": 'import numpy\ndef wave():\n    """A sum."""\n    return 1  # m\n',
        "arm/__init__.py": "from .inertia import mass\n",
        "arm/inertia.py": "mass = 1.0\n",
        "arm/solver.c": "int x; /* metres */\n",
    }.items():
        write_atomically(package / name, text.encode())
    monkeypatch.setattr(source, "PACKAGE", package)
    monkeypatch.setattr(source, "ROOT", tmp_path)
    forget()
    yield package
    forget()


def forget():
    for name in ("source_digests", "imported_libraries", "_digest", "_imported_by"):
        getattr(source, name).cache_clear()


def source_digest(module):
    forget()
    return source.source_digests(module)


# --- identity ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changed", ["plant.py", "arm/__init__.py", "arm/inertia.py", "arm/solver.c"]
)
def test_every_source_that_a_module_rests_on_is_part_of_its_identity(toy, changed):
    plant, sea = source_digest("toy.plant"), source_digest("toy.sea")
    path = toy / changed
    path.write_text(path.read_text() + "int y;" if path.suffix == ".c" else "mass = 2.0\n")
    assert source_digest("toy.plant") != plant
    assert source_digest("toy.sea") == sea


@pytest.mark.parametrize(
    ("name", "before", "after", "same"),
    [
        ("sea.py", "  # m", "  # metres\n", True),
        ("sea.py", '"""A sum."""', '"""A sum\n\n    of waves."""', True),
        ("sea.py", "return 1", "return '# 1'", False),
        ("arm/solver.c", "/* metres */", "// m", True),
        ("arm/solver.c", "int x;", 'char x[] = "/* m */";', False),
    ],
)
def test_only_code_counts(toy, name, before, after, same):
    module = {"sea.py": "toy.sea"}.get(name, "toy.arm")
    digest, path = source_digest(module), toy / name
    path.write_text(path.read_text().replace(before, after))
    assert (source_digest(module) == digest) is same


def test_the_front_door_counts_for_those_alone_who_enter_by_it(toy):
    plant, package = source_digest("toy.plant"), source_digest("toy")
    (toy / "sea.py").write_text("wave = 2\n")
    assert source_digest("toy.plant") == plant
    assert source_digest("toy") != package


def test_a_source_of_another_name_is_another_source(toy):
    before = source_digest("toy.plant")
    (toy / "arm/solver.c").rename(toy / "arm/solver2.c")
    assert source_digest("toy.plant") != before


def sources(run):
    return run_identity(run.compute, run.parameters).parts["source"]


def test_a_closed_loop_rests_on_no_measured_sea_and_on_no_solver_that_it_does_not_use(nominal):
    run = experiment("error_ratio").runs(nominal)[-1]
    assert not any("records" in name or "reference" in name for name in sources(run))
    assert any("compiled/engine.c" in name for name in sources(run))
    nmpc = replace(nominal.nmpc, solver="interior_point")
    other = experiment("error_ratio").runs(replace(nominal, nmpc=nmpc))[-1]
    solver = "softwave_min/control/reference/interior_point.py"
    assert solver in sources(other).keys() - sources(run).keys()


def test_identity_follows_the_parameters_and_the_lock(monkeypatch):
    assert square(2.0).identity == square(2.0).identity
    assert square(2.0).identity != square(np.nextafter(2.0, 3.0)).identity
    before = square(2.0).identity
    versions = {**identity._versions(), "sphinx": "0"}
    monkeypatch.setattr(identity, "_versions", lambda: versions)
    assert square(2.0).identity == before  # nothing is computed with it
    monkeypatch.setattr(identity, "imported_libraries", lambda *_: {"numpy"})
    before = square(2.0).identity
    versions["numpy"] = "0"
    assert square(2.0).identity != before


def test_what_changed_is_named(nominal):
    run = experiment("spectra").runs(nominal)[0]
    now = run_identity(run.compute, run.parameters)
    assert now.changes(now.parts) == []
    source = dict.fromkeys(now.parts["source"], "0")
    lock = {**now.parts["lock"], "numpy": "0"}
    assert now.changes({**now.parts, "lock": lock}) == ["lock (numpy)"]
    assert "more)" in now.changes({**now.parts, "source": source})[0]
    assert now.changes({**now.parts, "parameters": ""}) == ["parameters"]
    assert now.changes(None) == ["not recorded"]


def identities(name, parameters):
    return [run.identity for run in experiment(name).runs(parameters)]


def test_drag_determines_the_closed_loop_and_not_the_sea(nominal):
    fluid = replace(nominal.fluid, drag_coefficient=1.01 * nominal.fluid.drag_coefficient)
    other = replace(nominal, fluid=fluid)
    assert set(identities("example_case", nominal)).isdisjoint(identities("example_case", other))
    assert identities("spectra", nominal) == identities("spectra", other)


@pytest.mark.parametrize("name", NAMES)
def test_runs_of_an_experiment_have_names_and_identities_of_their_own(nominal, name):
    runs = experiment(name).runs(nominal)
    assert runs
    assert len({run.name for run in runs}) == len({run.identity for run in runs}) == len(runs)


# --- files ------------------------------------------------------------------------------


def test_a_run_comes_back_as_it_was_saved(shelf):
    run = square(3.0)
    assert not shelf.has(run)
    shelf.save_run(run, {"area": np.array(9.0), "path": np.eye(2)}, {"seconds": 1.0})
    assert shelf.has(run)
    np.testing.assert_array_equal(shelf.load_run(run)["path"], np.eye(2))
    assert shelf.run_record(run)["seconds"] == 1.0


def test_a_run_defined_otherwise_is_not_taken_for_the_saved_one(shelf):
    shelf.save_run(square(3.0), area(Square(3.0)), {})
    assert not shelf.has(square(4.0))
    with pytest.raises(FileNotFoundError, match="make results"):
        shelf.load_run(square(4.0))


def test_a_run_goes_when_nobody_asked_for_it_in_a_long_time(shelf):
    used, vanished = square(3.0), square(5.0)
    for run in (used, vanished):
        shelf.save_run(run, area(run.parameters), {})
    for path in shelf.root.glob("runs/*"):
        os.utime(path, (0, 0))
    assert shelf.has(used)
    tidy_runs(shelf.root)
    assert [shelf.has(run) for run in (used, vanished)] == [True, False]
    assert len(list(shelf.root.glob("runs/*"))) == 2  # a run and its record


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_run_is_never_read_as_valid(shelf, damage):
    run = square(3.0)
    shelf.save_run(run, {"path": np.random.default_rng(1).normal(size=1000)}, {})
    path = shelf.run_path(run)
    content = bytearray(path.read_bytes())
    if damage == "cut":
        del content[len(content) // 2 :]
    else:
        content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert not shelf.has(run)  # so that the next sweep mends it
    with pytest.raises(FileNotFoundError, match="make results"):
        shelf.load_run(run)


def test_an_interrupted_write_leaves_the_former_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "table.csv"
    write_atomically(path, b"former")

    def interrupted(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, b"new, but never finished")
    assert path.read_bytes() == b"former"
    assert list(tmp_path.iterdir()) == [path]


def test_tables_keep_ten_digits():
    table = pd.DataFrame({"case": ["W1", "W2"], "rmse": [np.pi, 1e-12 / 3]})
    text = table_text(table)
    assert text.splitlines()[0] == "case,rmse"
    np.testing.assert_allclose(read_table(io.StringIO(text))["rmse"], table["rmse"], rtol=1e-9)


# --- sweeps -----------------------------------------------------------------------------


def test_a_sweep_computes_what_is_missing_and_nothing_twice(shelf, nominal):
    assert freshness(squares(1.0, 2.0), nominal, shelf) is Freshness.MISSING
    assert compute(squares(1.0, 2.0), nominal, shelf, Processes(1)) == 2
    assert compute(squares(1.0, 2.0), nominal, shelf, Processes(1)) == 0
    assert compute(squares(1.0, 2.5), nominal, shelf, Processes(1)) == 1
    assert list(shelf.read_table("areas")["area"]) == [1.0, 6.25]


def test_a_sweep_that_failed_keeps_the_runs_that_did_not(shelf, nominal):
    with pytest.raises(SweepError, match="s1: negative side"):
        compute(squares(1.0, -1.0, 3.0), nominal, shelf, Processes(1))
    assert not shelf.provenance()
    assert compute(squares(1.0, 2.0, 3.0), nominal, shelf, Processes(1)) == 1


def freshness(experiment, parameters, store):
    return Task(experiment, parameters, store).freshness


@pytest.fixture
def finished(shelf, nominal, monkeypatch):
    """The shelf with the tables of one square, and figures as it were."""
    monkeypatch.setattr(Task, "figures", [])
    compute(squares(1.0), nominal, shelf, Processes(1))
    return shelf


def test_results_are_stale_once_their_definition_or_a_file_has_changed(finished, nominal):
    assert freshness(squares(1.0), nominal, finished) is Freshness.FRESH
    assert freshness(squares(2.0), nominal, finished) is Freshness.STALE
    table = finished.folder / "areas.csv"
    table.write_text(table.read_text().replace("1", "2"))
    assert freshness(squares(1.0), nominal, finished) is Freshness.STALE


def test_tables_without_their_runs_count_as_committed(finished, nominal):
    shutil.rmtree(finished.root / "runs")
    assert freshness(squares(1.0), nominal, finished) is Freshness.COMMITTED


def test_a_file_that_is_read_for_a_table_determines_it(shelf, nominal, tmp_path):
    limits = tmp_path / "limits.toml"
    limits.write_text("most = 2.0")

    def tabulate(_, runs):
        return {"most": pd.DataFrame({"most": [read_toml(limits)["most"]], "runs": [len(runs)]})}

    judged = replace(squares(1.0), tabulate=tabulate)
    compute(judged, nominal, shelf, Processes(1))
    limits.write_text("most = 3.0")
    assert Task(judged, nominal, shelf).tables == [f"data (results/{limits.name})"]
    assert compute(judged, nominal, shelf, Processes(1)) == 0
    assert list(shelf.read_table("most")["most"]) == [3.0]


def test_a_run_that_reads_a_file_fails(shelf, nominal):
    reads = replace(squares(), runs=lambda _: [Run("s", reads_a_file, Square(1.0))])
    with pytest.raises(SweepError, match=r"a run reads no file.*wave_cases\.toml"):
        compute(reads, nominal, shelf, Processes(1))


def reads_a_file(_):
    return {"cases": np.array(len(wave_cases()))}


def as_committed_elsewhere(shelf, factor):
    """The tables as another machine made them, without what was computed here."""
    shutil.rmtree(shelf.root / "runs")
    table = shelf.read_table("areas")
    shelf.write_table("areas", table * factor)
    shelf.write_provenance({**shelf.provenance(), "files": shelf.file_digests(), "commit": "old"})
    return {path.name: path.read_bytes() for path in shelf.files()}


@pytest.mark.parametrize(("factor", "record", "kept"), [
    (1 + 1e-6, False, True), (1 + 1e-6, True, False), (1 + 1e-3, False, False),
])  # fmt: skip
def test_committed_tables_stay_unless_a_number_moved_or_they_are_to_be_recorded(
    shelf, nominal, factor, record, kept
):
    compute(squares(3.0), nominal, shelf, Processes(1))
    committed = as_committed_elsewhere(shelf, factor)
    (swept,) = compute_all([Task(squares(3.0), nominal, shelf)], Processes(1), record=record)
    assert swept.published is not kept
    assert ({path.name: path.read_bytes() for path in shelf.files()} == committed) is kept
    assert list(shelf.latest().read_table("areas")["area"]) == [9.0]
    assert not Task(squares(3.0), nominal, shelf).made
