"""The command line and the Makefile, as a person meets them."""

from __future__ import annotations

import re
import shutil
import socket
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import pytest
from shell import command
from toy_sweep import die, install, toy

from softwave_min import commands
from softwave_min.command_line import main
from softwave_min.data import ROOT, ParameterError, data_folder
from softwave_min.figures import files
from softwave_min.runs import compare, executor
from softwave_min.runs.experiment import Run, Tolerance
from softwave_min.studies.catalogue import NAMES, experiment

NOMINAL = data_folder() / "parameters" / "calibrated.toml"
TARGETS = {
    "all", "results", "notebooks", "book", "figures", "lab", "bench", "verify", "lock", "clean",
    "help", "test", "environment", "mutation", "seeds", "audit", "calibration", "sensitivity",
    "record", "lint",
}  # fmt: skip


def softwave(*arguments, **options):
    return command(sys.executable, "-m", "softwave_min", *arguments, **options)


# --- a wrong parameter file -------------------------------------------------------------

FINITE = "must be a finite number"
WRONG = {
    "missing field": (r"^drag_coefficient = .*\n", "", "fluid.drag_coefficient", "missing"),
    "missing section": (r"^\[preview\]\n(.+\n)*", "", "preview", "missing"),
    "negative": (r"^length = \[0\.3,", "length = [-0.3,", "arm.length.0", f"-0.3: {FINITE} > 0"),
    "text": (r"^peak_period = [\d.]+", "peak_period = 'x'", "sea.peak_period", f"'x': {FINITE}"),
    "unknown": (r"^\[nmpc\]\n", "[nmpc]\nhorizont = 3\n", "nmpc.horizont", "known here: control"),
    "NaN": (r"^density = 1025\.0", "density = nan", "fluid.density", "nan: must be"),
    "low": (r"^inertia_coefficient = [\d.]+", "inertia_coefficient = 0.5", f"0.5: {FINITE} >= 1"),
    "option": (r'^morison = "paper"', 'morison = "papre"', "must be 'paper' or 'textbook'"),
    "not TOML": (r"^\[arm\]", "[arm", "not valid TOML", "line"),
}


@pytest.fixture
def refusal(tmp_path, monkeypatch, capsys):
    """Run the command line; the one line with which it refuses."""
    monkeypatch.setenv("SOFTWAVE_RESULTS", str(tmp_path / "results"))

    def run(*arguments):
        assert main([str(argument) for argument in arguments]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        assert not (tmp_path / "results").exists()
        return printed.err

    return run


def mistaken(folder, mistake):
    """The nominal file with a mistake in it."""
    pattern, replacement, *_ = WRONG[mistake]
    text, count = re.subn(pattern, replacement, NOMINAL.read_text(), count=1, flags=re.MULTILINE)
    assert count == 1
    path = folder / "mine.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_parameter_file_is_refused_in_one_line(tmp_path, refusal, mistake):
    path = mistaken(tmp_path, mistake)
    line = refusal("run", "--parameters", path)
    for part in (str(path), *WRONG[mistake][2:]):
        assert part in line


def test_a_refusal_is_exit_status_2_and_no_traceback(tmp_path):
    path = mistaken(tmp_path, "NaN")
    answer = softwave("run", "--parameters", path, SOFTWAVE_RESULTS=tmp_path)
    assert (answer.returncode, answer.stdout, answer.stderr.count("\n")) == (2, "", 1)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("run", "--parameters", "absent.toml"), "absent.toml: No such file"),
        (("status", "--parameters", ROOT / "data"), str(ROOT / "data")),
        (("run", "exmaple_case"), "exmaple_case"),
        (("run", "--set", "nominal"), "'nominal'; there are: calibrated, physical"),
        (("verify", "exmaple_case"), "exmaple_case"),
    ],
)
def test_a_wrong_name_is_refused_in_one_line(refusal, arguments, complaint):
    assert complaint in refusal(*arguments)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "COMMAND"),
        (("compute",), "'compute'"),
        (("run", "--jobs", "0"), "'0' is not a whole number, 1 or more"),
        (("run", "--seeds", "many"), "'many' is not a whole number, 1 or more"),
        (("run", "--set", "physical", "--parameters", "mine.toml"), "not allowed with"),
        (("run", "--jobs", "2", "--scheduler", "host:8786"), "not allowed with"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(capsys, arguments, complaint):
    with pytest.raises(SystemExit, match=r"^2$"):
        main(arguments)
    printed = capsys.readouterr()
    assert complaint in printed.err
    assert (printed.out, printed.err.count("\n")) == ("", 1)


def test_a_file_of_the_same_name_as_a_shipped_set_is_refused(tmp_path, refusal):
    path = shutil.copy(NOMINAL, tmp_path / "physical.toml")
    assert "call it otherwise" in refusal("run", "--parameters", path)


def test_a_scheduler_that_does_not_answer_is_refused_in_one_line(refusal, monkeypatch):
    monkeypatch.setattr(executor, "CONNECTING", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and nobody listens
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        assert f"--scheduler {address}: no Dask scheduler" in refusal("run", "--scheduler", address)


# --- what is computed, and where it goes ------------------------------------------------


THREE = toy(range(3), 0.0)


@pytest.fixture
def toys(tmp_path, monkeypatch, capsys):
    """The command line with toys for experiments: what it prints, on success."""
    monkeypatch.setenv("SOFTWAVE_RESULTS", str(tmp_path / "results"))
    monkeypatch.setattr(commands, "NAMES", NAMES)  # restored in the end
    monkeypatch.setattr(commands, "experiment", commands.experiment)

    def run(*arguments, known=THREE, status=0):
        install(*(known if isinstance(known, tuple) else (known,)))
        assert main([str(argument) for argument in arguments]) == status
        return capsys.readouterr().out

    return run


def files_below(folder):
    files = (path for path in folder.rglob("*") if path.is_file() and "runs" not in path.parts)
    return sorted(path.relative_to(folder).as_posix() for path in files)


@pytest.mark.parametrize(
    ("arguments", "place"),
    [
        ((), "toy"),
        (("--set", "calibrated"), "toy"),
        (("--parameters", NOMINAL), "toy"),
        (("--set", "physical"), "sets/physical/toy"),
        (("--parameters", "mine.toml"), "sets/mine/toy"),
        (("--seeds", "1"), "toy"),
        (("--seeds", "2"), "sets/calibrated-2-seeds/toy"),
        (("--set", "physical", "--seeds", "3"), "sets/physical-3-seeds/toy"),
        (("--results", "results/here", "--set", "physical"), "here/toy"),
    ],
)
def test_only_the_default_set_writes_where_the_committed_results_are(
    tmp_path, toys, monkeypatch, arguments, place
):
    monkeypatch.chdir(tmp_path)
    shutil.copy(NOMINAL, "mine.toml")
    toys("run", "--jobs", "1", *arguments)
    names = ("means.csv", "provenance.json", "total.csv")
    assert files_below(tmp_path / "results") == [f"{place}/{name}" for name in names]
    assert toys("status", *arguments) == "toy: fresh\n"


def test_seeds_are_random_seas_for_each_case(tmp_path, toys):
    assert "toy: 6 runs computed" in toys("run", "--seeds", "2", "--jobs", "1")
    table = (tmp_path / "results/sets/calibrated-2-seeds/toy/means.csv").read_text()
    assert [line.split(",")[0] for line in table.splitlines()[1:]] == [
        "s0-0", "s0-1", "s1-0", "s1-1", "s2-0", "s2-1",
    ]  # fmt: skip


def test_a_second_run_computes_and_draws_nothing(toys):
    first, second = (toys("run", "--jobs", "1").splitlines()[1:] for _ in range(2))
    assert first[0].startswith("toy: 3 runs computed in")
    assert first[1:] == ["toy: figures drawn"]
    assert second == ["toy: up to date"]


@pytest.mark.parametrize("arguments", [("run", "--jobs", "1"), ("run", "--dry-run"), ("status",)])
def test_parameters_that_one_experiment_cannot_take_leave_the_others_alone(toys, capsys, arguments):
    def runs(_):
        raise ParameterError("needs an arm of two segments")

    picky = replace(THREE, name="picky", runs=runs)
    install(picky, THREE)
    assert main(arguments) == 1
    printed = capsys.readouterr()
    assert printed.err == "picky: needs an arm of two segments\n"
    assert "toy: " in printed.out
    computed = arguments[-1] == "1"
    assert toys("status") == f"toy: {'fresh' if computed else 'missing'}\n"


def test_make_audit_names_all_that_is_on_request():
    recipe = (ROOT / "Makefile").read_text().partition("\naudit:")[2].splitlines()[1]
    named = recipe.rpartition(" run ")[2].split()
    assert sorted(named) == sorted(name for name in NAMES if experiment(name).on_request)


def test_what_is_on_request_is_computed_when_named_and_only_then(toys):
    for_ever, longer = (toy(range(count), 0.0, on_request=True) for count in (3, 4))
    assert "toy" not in toys("run", known=for_ever)
    assert toys("status", known=for_ever) == "toy: missing\n"
    assert "3 runs computed" in toys("run", "toy", "--jobs", "1", known=for_ever)
    assert "toy" not in toys("run", known=for_ever)
    assert toys("status", known=for_ever) == "toy: fresh\n"
    assert "toy: stale; computed on request only" in toys("run", known=longer)
    assert toys("status", known=longer, status=1) == "toy: stale\n"
    assert "1 runs computed" in toys("run", "toy", known=longer)


def test_the_list_says_how_much_there_is_to_compute_and_for_which_claims(toys):
    listed = toys("list", "--seeds", "2", known=toy(range(3), on_request=True))
    assert listed.split() == [
        "toy", "6", "runs", "on", "request", "C01-C02,", "C04", "Random", "samples",
    ]  # fmt: skip
    assert "on request" not in toys("list")


def test_a_failed_run_is_exit_status_1_and_no_tables(tmp_path, toys):
    printed = toys("run", "--jobs", "1", known=toy((-1, 0, 1), 0.0), status=1)
    assert "figures drawn" not in printed
    assert files_below(tmp_path / "results") == []


def test_a_dry_run_says_what_is_missing_or_stale_and_why(tmp_path, toys):
    def planned(known=THREE):
        return toys("run", "--dry-run", known=known).strip()

    assert planned().startswith("toy: compute 3 of 3 runs; tables: not recorded")
    assert not (tmp_path / "results").exists()
    toys("run", "--jobs", "1")
    assert planned() == "toy: up to date"
    (longer,) = planned(known=toy(range(4), 0.0)).splitlines()
    assert longer == "toy: compute 1 of 4 runs; tables: parameters; figures: tables"


def test_figures_that_fail_are_exit_status_1_and_leave_the_others_alone(toys, monkeypatch):
    monkeypatch.setattr(commands, "draw_files", fails_for_toy)
    other = replace(THREE, name="other")
    printed = toys("run", "--jobs", "1", known=(THREE, other), status=1)
    assert "other: figures drawn" in printed
    assert "toy: figures drawn" not in printed


def fails_for_toy(store, _):
    if store.experiment == "toy":
        raise ZeroDivisionError


def test_figures_are_drawn_though_a_run_takes_the_painter_along(toys, monkeypatch):
    fatal = replace(THREE, name="fatal", runs=lambda _: [Run(f"d{i}", die, i) for i in range(2)])
    monkeypatch.setattr(commands, "draw_files", drawn_slowly)
    printed = toys("run", "--jobs", "2", known=(THREE, fatal), status=1)
    assert "toy: figures drawn" in printed
    assert "fatal: figures" not in printed


def drawn_slowly(*_):
    time.sleep(1.0)


def test_a_figure_is_closed_once_it_is_written(toys, monkeypatch):
    import matplotlib.pyplot as plt

    from softwave_min.figures.style import Drawing

    drawn = SimpleNamespace(draw=lambda *_: {"toy": Drawing(plt.subplots()[0], "A toy.", "A toy.")})
    monkeypatch.setattr(files, "import_module", lambda _: drawn)
    open_before = plt.get_fignums()
    assert "toy: figures drawn" in toys("run", "--jobs", "1")
    assert plt.get_fignums() == open_before == []


# --- against the committed tables -------------------------------------------------------


@pytest.fixture
def committed(tmp_path, toys, monkeypatch):
    """Compute the toy's tables, change one of them, and commit them to a repository."""
    monkeypatch.setattr(compare, "ROOT", tmp_path)

    def commit(name="means.csv", *, change=lambda text: text):
        toys("run", "--jobs", "1")
        path = tmp_path / "results" / "toy" / name
        path.write_text(change(path.read_text() if path.exists() else ""))
        (tmp_path / ".gitignore").write_text("runs/\n")
        author = ("-c", "user.name=nobody", "-c", "user.email=nobody@localhost")
        for arguments in (("init", "-q"), ("add", "results"), (*author, "commit", "-qm", "all")):
            assert command("git", *arguments, folder=tmp_path).returncode == 0
        shutil.rmtree(tmp_path / "results")

    return commit


def test_tables_that_come_out_as_committed_are_verified(tmp_path, committed, toys):
    committed()
    lines = toys("verify", "--jobs", "1").splitlines()
    assert lines[1:] == ["toy/means.csv: 3 rows, identical", "toy/total.csv: 1 rows, identical"]
    assert not (tmp_path / "results").exists()


def off_by_a_thousandth(text):
    return re.sub(r"(?<=s1-0,)\S+", lambda found: repr(float(found[0]) * 1.001), text)


def test_verify_says_what_differs_where_and_by_how_much(committed, toys):
    committed(change=off_by_a_thousandth)
    lines = toys("verify", "toy", "--jobs", "1", status=1).splitlines()
    assert "means.csv: 3 rows DIFFER" in lines[1]
    assert lines[2].startswith("  mean: 1 of 3 rows; row 2 (run s1-0): ")
    assert "(1.0e-03 relative); allowed 1e-06 or 0.0001 relative" in lines[2]
    assert "identical" in lines[3]


def test_verify_heeds_the_tolerance_of_each_column(committed, toys):
    committed(change=off_by_a_thousandth)
    loose = toy(range(3), 0.0, tolerances={"mean": Tolerance(2e-3)})
    assert "means.csv: 3 rows agree" in toys("verify", "--jobs", "1", known=loose)
    elsewhere = toy(range(3), 0.0, tolerances={"total.mean": Tolerance(2e-3)})
    assert "DIFFER" in toys("verify", "--jobs", "1", known=elsewhere, status=1)


def test_verify_misses_a_committed_table_that_is_not_made_any_more(committed, toys):
    committed("extra.csv", change=lambda _: "a\n1\n")
    assert "toy/extra.csv: DIFFERS" in toys("verify", "--jobs", "1", status=1)


@pytest.mark.usefixtures("toys")
def test_verify_has_nothing_to_say_where_nothing_is_committed(refusal):
    install(THREE)
    assert "no tables are committed" in refusal("verify", "toy")


def test_a_strict_comparison_without_a_commit_fails_in_one_line(
    tmp_path, toys, monkeypatch, capsys
):
    monkeypatch.setattr(compare, "ROOT", tmp_path)
    toys("run", "--jobs", "1")
    assert "no committed table" in toys("compare")
    assert main(["compare", "--strict"]) == 1
    printed = capsys.readouterr()
    assert (printed.out, printed.err.count("\n")) == ("", 1)
    assert "no commit to compare with" in printed.err


def test_what_is_compared_was_made_here_though_the_committed_tables_stay(tmp_path, committed, toys):
    committed()
    command("git", "checkout", "-q", "results", folder=tmp_path)
    lenient = toy(range(3), 0.0, tolerances={"mean": Tolerance(2e-3)})
    toys("run", "--jobs", "1", known=lenient)
    table = tmp_path / "results/runs/tables/toy/means.csv"
    table.write_text(off_by_a_thousandth(table.read_text()))
    assert "largest relative difference 1.0e-03" in toys("compare", "--strict", known=lenient)
    assert "DIFFER" in toys("compare", "--strict", status=1)
    assert command("git", "status", "--porcelain", "results", folder=tmp_path).stdout == ""


# --- freshness --------------------------------------------------------------------------


def test_results_that_were_never_computed_are_missing_and_no_error(tmp_path, capsys):
    assert main(["status", "--results", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [f"{name}: missing" for name in NAMES]


def test_another_number_makes_stale_what_depends_on_it_and_nothing_else(tmp_path):
    """In a copy of what determines the results, with the results that are committed."""
    for name, ignored in {"softwave_min": "__pycache__", "data": "", "results": "runs"}.items():
        ignore = shutil.ignore_patterns(ignored)
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignore)
    shutil.copy(ROOT / "environment.lock", tmp_path)

    def freshness():
        answer = softwave("status", folder=tmp_path, PYTHONPATH=tmp_path)
        return answer.returncode, dict(line.split(": ") for line in answer.stdout.splitlines())

    assert freshness() == (0, dict.fromkeys(NAMES, "committed"))
    for file, field, stale, not_stale in (
        ("parameters/calibrated.toml", "drag_coefficient", "example_case", "spectra"),
        ("paper/error_ratio.toml", "below_one", "error_ratio", "example_case"),
    ):
        path = tmp_path / "data" / file
        before = path.read_text()
        path.write_text(re.sub(rf"(?m)^(\w*{field}\w* = )[\d.]+", r"\g<1>1.2", before))
        status, found = freshness()
        assert (status, found[stale], found[not_stale]) == (1, "stale", "committed")
        path.write_text(before)


# --- make -------------------------------------------------------------------------------


def test_help_explains_each_target_in_a_line():
    lines = command("make", "help").stdout.splitlines()
    explained = {line.split()[1]: " ".join(line.split()[2:]) for line in lines}
    assert set(explained) >= TARGETS
    assert all(explained.values())
    assert all(len(line) <= 100 for line in lines)


@pytest.fixture
def bare(tmp_path):
    """The files that an environment is made of, in a folder that has none yet."""
    for name in ("Makefile", "environment.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    return tmp_path


def python_of_version(folder, version):
    path = folder / "python3"
    path.write_text(f"#!/bin/sh\necho {version}\n")
    path.chmod(0o755)
    return path


@pytest.mark.parametrize("version", ["2.7", "3.6", "3.10"])
def test_a_python_too_old_is_one_clear_line(bare, version):
    old = python_of_version(bare, version)
    answer = command("make", "environment", f"PYTHON={old}", folder=bare)
    assert (answer.returncode, answer.stdout, answer.stderr.count("\n")) == (2, "", 1)
    assert "Python 3.11 or newer is needed" in answer.stderr
    assert f"{old} is {version}" in answer.stderr
    assert not (bare / ".venv").exists()


def test_the_first_python_that_is_recent_enough_is_taken(bare):
    old = python_of_version(bare, "3.10")
    recipe = command(
        "make", "-n", "environment", "UV=uv", f"PYTHON=absent {old} {sys.executable}", folder=bare
    )
    assert recipe.returncode == 0
    assert f'venv --quiet --python "{sys.executable}"' in recipe.stdout


def test_an_environment_is_installed_by_hash_and_no_file_names_where_from():
    lock = (ROOT / "environment.lock").read_text()
    packages = re.findall(r"(?m)^[\w.-]+==", lock)
    assert len(packages) > 50
    assert all("--hash=sha256:" in entry for entry in re.split(r"(?m)^(?=\S)", lock) if entry)
    for name in ("environment.lock", "Makefile", "pyproject.toml", "requirements.in"):
        assert not re.search(r"https?://|index-url|find-links", (ROOT / name).read_text())
