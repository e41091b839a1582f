"""Results on disk, and what identifies them."""

from __future__ import annotations

import dataclasses
import io
import os
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from softwave_min.runs import identity, sweep
from softwave_min.runs.executor import Processes
from softwave_min.runs.experiment import Experiment, Run
from softwave_min.runs.store import Store, read_table, table_text, write_atomically
from softwave_min.runs.sweep import Freshness, SweepError, compute, freshness
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
        "__init__.py": "",
        "plant.py": "from toy.arm import mass\n",
        "sea.py": "import numpy\n",
        "arm/__init__.py": "from .inertia import mass\n",
        "arm/inertia.py": "mass = 1.0\n",
        "arm/solver.c": "int x;\n",
    }.items():
        write_atomically(package / name, text.encode())
    monkeypatch.setattr(identity, "PACKAGE", package)
    monkeypatch.setattr(identity, "ROOT", tmp_path)
    identity.source_digest.cache_clear()
    yield package
    identity.source_digest.cache_clear()


def source_digest(module):
    identity.source_digest.cache_clear()
    return identity.source_digest(module)


# --- identity ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "changed", ["plant.py", "arm/__init__.py", "arm/inertia.py", "arm/solver.c"]
)
def test_every_source_that_a_module_rests_on_is_part_of_its_identity(toy, changed):
    plant, sea = source_digest("toy.plant"), source_digest("toy.sea")
    path = toy / changed
    path.write_text(path.read_text() + " ")
    assert source_digest("toy.plant") != plant
    assert source_digest("toy.sea") == sea


def test_a_source_of_another_name_is_another_source(toy):
    before = source_digest("toy.plant")
    (toy / "arm/solver.c").rename(toy / "arm/solver2.c")
    assert source_digest("toy.plant") != before


def test_identity_follows_the_parameters_and_the_lock(monkeypatch):
    assert square(2.0).identity == square(2.0).identity
    assert square(2.0).identity != square(np.nextafter(2.0, 3.0)).identity
    before = square(2.0).identity
    monkeypatch.setattr(identity, "lock_digest", lambda: "another lock")
    assert square(2.0).identity != before


def with_drag(parameters, coefficient):
    fluid = dataclasses.replace(parameters.fluid, drag_coefficient=coefficient)
    return dataclasses.replace(parameters, fluid=fluid)


def identities(name, parameters):
    return [run.identity for run in experiment(name).runs(parameters)]


def test_drag_determines_the_closed_loop_and_not_the_sea(nominal):
    other = with_drag(nominal, 1.01 * nominal.fluid.drag_coefficient)
    closed_loop = zip(
        identities("example_case", nominal), identities("example_case", other), strict=True
    )
    assert all(before != after for before, after in closed_loop)
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


def test_a_new_definition_replaces_the_files_of_the_former_alone(shelf):
    for run in (square(3.0), square(5.0, "square-2"), square(4.0)):
        shelf.save_run(run, area(run.parameters), {})
    shelf.tidy([square(4.0)])
    assert not shelf.has(square(3.0))
    assert shelf.has(square(4.0))
    assert shelf.has(square(5.0, "square-2"))
    assert len(list(shelf.folder.glob("runs/*"))) == 4  # two runs, each with its record


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


@pytest.fixture
def finished(shelf, nominal, monkeypatch):
    """The shelf with the tables of one square, and figures as it were."""
    monkeypatch.setattr(sweep, "figures_identity", lambda *_: "drawn")
    compute(squares(1.0), nominal, shelf, Processes(1))
    shelf.write_provenance({**shelf.provenance(), "figures_identity": "drawn"})
    return shelf


def test_results_are_stale_once_their_definition_or_a_file_has_changed(finished, nominal):
    assert freshness(squares(1.0), nominal, finished) is Freshness.FRESH
    assert freshness(squares(2.0), nominal, finished) is Freshness.STALE
    table = finished.folder / "areas.csv"
    table.write_text(table.read_text().replace("1", "2"))
    assert freshness(squares(1.0), nominal, finished) is Freshness.STALE


def test_tables_without_their_runs_count_as_committed(finished, nominal):
    for path in finished.folder.glob("runs/*"):
        path.unlink()
    assert freshness(squares(1.0), nominal, finished) is Freshness.COMMITTED
