"""The command line and the Makefile, as a person meets them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from softwave_min.__main__ import main
from softwave_min.experiments import NAMES
from softwave_min.identity import ROOT
from softwave_min.parameters import data_folder

NOMINAL = data_folder() / "parameters" / "calibrated.toml"
TARGETS = {
    "all", "results", "notebooks", "book", "figures", "lab", "bench", "verify", "lock", "clean",
    "help", "test", "environment",
}  # fmt: skip


def command(*arguments, folder=ROOT, **environment):
    """Run a command to its end; what it printed and its exit status."""
    return subprocess.run(
        [str(argument) for argument in arguments],
        cwd=folder,
        env={**os.environ, **{name: str(value) for name, value in environment.items()}},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def softwave(*arguments, **options):
    return command(sys.executable, "-m", "softwave_min", *arguments, **options)


# --- a wrong parameter file -------------------------------------------------------------

WRONG = {
    "missing field": (r"^drag_coefficient = .*\n", "", "fluid.drag_coefficient", "missing"),
    "missing section": (r"^\[preview\]\n(.+\n)*", "", "preview", "missing"),
    "negative length": (
        r"^length = \[0\.3,",
        "length = [-0.3,",
        "arm.length.0",
        "-0.3: must be a finite number > 0",
    ),
    "text for a number": (
        r"^peak_period = [\d.]+",
        'peak_period = "ten"',
        "sea.peak_period",
        "'ten': must be a finite number",
    ),
    "unknown field": (
        r"^\[nmpc\]\n",
        "[nmpc]\nhorizont = 3\n",
        "nmpc.horizont",
        "unknown field; known here: control_period, horizon,",
    ),
    "NaN": (
        r"^density = 1025\.0",
        "density = nan",
        "fluid.density",
        "nan: must be",
    ),
    "out of range": (
        r"^inertia_coefficient = [\d.]+",
        "inertia_coefficient = 0.5",
        "fluid.inertia_coefficient",
        "0.5: must be a finite number >= 1",
    ),
    "unknown option": (
        r'^morison = "paper"',
        'morison = "papre"',
        "fluid.morison",
        "'papre': must be 'paper' or 'textbook'",
    ),
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
    ],
)
def test_a_wrong_name_is_refused_in_one_line(refusal, arguments, complaint):
    assert complaint in refusal(*arguments)


# --- freshness --------------------------------------------------------------------------


@pytest.fixture
def house(tmp_path):
    """A copy of what determines the results, with the results that are committed."""
    for name in ("softwave_min", "data", "results"):
        ignored = shutil.ignore_patterns("runs", "__pycache__")
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignored)
    shutil.copy(ROOT / "environment.lock", tmp_path)
    return tmp_path


def freshness(folder, **environment):
    answer = softwave("status", folder=folder, PYTHONPATH=folder, **environment)
    return answer.returncode, dict(line.split(": ") for line in answer.stdout.splitlines())


def test_results_that_were_never_computed_are_missing_and_no_error(house):
    status, found = freshness(house, SOFTWAVE_RESULTS=house / "nowhere")
    assert (status, found) == (0, dict.fromkeys(NAMES, "missing"))


def test_another_drag_makes_stale_what_depends_on_it_and_nothing_else(house):
    assert freshness(house) == (0, dict.fromkeys(NAMES, "committed"))
    path = house / "data/parameters/calibrated.toml"
    path.write_text(
        re.sub(r"(?m)^drag_coefficient = [\d.]+", "drag_coefficient = 1.2", path.read_text())
    )
    status, found = freshness(house)
    assert status == 1
    assert found["spectra"] == "committed"
    assert found["example_case"] == "stale"


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


def python_of_version(folder: Path, version: str) -> Path:
    path = folder / "python3"
    path.write_text(f"#!/bin/sh\necho {version}\n")
    path.chmod(0o755)
    return path


@pytest.mark.parametrize("version", ["2.7", "3.6", "3.10"])
def test_a_python_too_old_is_one_clear_line(bare, version):
    old = python_of_version(bare, version)
    answer = command("make", "environment", f"PYTHON={old}", folder=bare)
    assert answer.returncode == 2
    assert answer.stdout == ""
    assert answer.stderr.count("\n") == 1
    assert "Python 3.11 or newer is needed" in answer.stderr
    assert f"{old} is {version}" in answer.stderr
    assert not (bare / ".venv").exists()


def test_the_first_python_that_is_recent_enough_is_taken(bare):
    old = python_of_version(bare, "3.10")
    recipe = command(
        "make", "-n", "environment", f"PYTHON=absent {old} {sys.executable}", folder=bare
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
