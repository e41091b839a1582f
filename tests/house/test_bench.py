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


def test_the_book_shows_a_table_or_does_not_build(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("kind,ms\na,-1.234\nb,5.678\na,\n", encoding="utf-8")
    (tmp_path / "m.json").write_text('{"cores": 2, "clean": true}', encoding="utf-8")
    source = tmp_path / "book"
    source.mkdir()
    good = (
        "```{quoted-table} t.csv\n:caption: All.\n:where: kind=a\n"
        "kind | of | \nms | ms | .1f\n```\n\n"
        "```{quoted-table} m.json\n```\n"
    )
    bad = (
        "```{quoted-table} none.csv\nkind | of |\n```\n\n"
        "```{quoted-table} t.csv\nnone | of |\n```\n\n"
        "```{quoted-table} t.csv\n:where: kind=c\nkind | of |\n```\n\n"
        "```{quoted-table} t.csv\nkind | of | .1f\n```\n"
    )
    extensions = f"import sys\nsys.path.insert(0, {str(ROOT / 'book' / '_ext')!r})\n"
    (source / "conf.py").write_text(
        f"{extensions}extensions = ['myst_parser', 'quoted']\n", encoding="utf-8"
    )

    def build(text: str) -> subprocess.CompletedProcess[str]:
        (source / "index.md").write_text(f"# Page\n\n{text}", encoding="utf-8")
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html"]
        return subprocess.run(
            [*command, source, tmp_path / "out"], capture_output=True, text=True, check=False
        )

    answer = build(good)
    assert answer.returncode == 0, answer.stderr
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert "\N{MINUS SIGN}1.2" in page
    assert "\N{EN DASH}" in page
    assert "5.7" not in page
    assert "<p>yes</p>" in page
    assert build(bad).stderr.count("WARNING") == 4
