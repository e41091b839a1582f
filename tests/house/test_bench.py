"""The bench runs, and its tables hold together."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

from softwave_min.data import ROOT
from softwave_min.native import compiler


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    command = [sys.executable, ROOT / "bench" / "run.py", "--quick", "--output", folder]
    answer = subprocess.run(command, check=True, capture_output=True, text=True)
    (folder / "printed.txt").write_text(answer.stdout, encoding="utf-8")
    return folder


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_every_method_solves_every_recorded_problem(written: Path) -> None:
    methods = rows_of(written / "steps.csv")
    assert len(methods) == (1 if compiler() is None else 5)
    assert {row["solves"] for row in methods} == {"10"}
    for row in methods:
        assert 0 < float(row["median_ms"]) <= float(row["percentile_95_ms"])
        assert int(row["failures"]) == 0
        converged = "SQP" in row["method"]
        assert (float(row["deviation"]) < 1e-5) == converged


def test_more_real_time_steps_come_closer_to_the_converged_loop(written: Path) -> None:
    rows = rows_of(written / "real_time.csv")
    for sea in ("jonswap", "measured"):
        change = {row["steps"]: float(row["change_percent"]) for row in rows if row["sea"] == sea}
        assert change["converged"] == 0
        assert abs(change["1"]) > abs(change["2"]) > abs(change["3"])


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_the_loop_and_the_growth_are_those_of_the_compiled_engine(written: Path) -> None:
    assert [row["pose"] for row in rows_of(written / "loops.csv")] == ["P1", "P3"]
    grown = [(row["axis"], row["value"]) for row in rows_of(written / "growth.csv")]
    assert grown == [("horizon", "10"), ("horizon", "20"), ("segments", "3")]


def test_a_bar_is_judged_by_what_was_measured(written: Path) -> None:
    for row in rows_of(written / "bars.csv"):
        measured, limit = float(row["measured"]), float(row["limit"])
        met = measured >= limit if row["sense"] == "at least" else measured <= limit
        assert row["verdict"] == ("pass" if met else "MISSED")


def test_the_parameter_set_of_an_error_is_named_where_it_is_not_the_books(written: Path) -> None:
    printed = (written / "printed.txt").read_text(encoding="utf-8")
    above = printed.split("change_percent")[0].splitlines()[-2]
    assert "'physical'" in above
    assert "book" in above
    assert "'calibrated'" in above
    machine = json.loads((written / "machine.json").read_text(encoding="utf-8"))
    assert machine["parameters"] == "physical"


def test_the_machine_is_named(written: Path) -> None:
    machine = json.loads((written / "machine.json").read_text(encoding="utf-8"))
    assert machine["python"] == ".".join(map(str, sys.version_info[:3]))
    assert {"processor", "cores", "compiler", "casadi", "date", "commit"} <= set(machine)
