"""The package as others meet it: what it imports, what a wheel holds, what its extras are."""

from __future__ import annotations

import importlib.metadata
import json
import re
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from shell import command, python

import softwave_min as sw
from softwave_min.data import ROOT
from softwave_min.native import compiler

HEAVY = {"SALib", "cma", "cvxpy", "distributed", "duckdb", "loky", "matplotlib", "pandas", "tqdm"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_front_door_is_fifteen_names():
    assert len(sw.__all__) == 15
    assert all(getattr(sw, name).__doc__ for name in sw.__all__)
    assert set(sw.__all__) <= set(dir(sw))
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        _ = sw.simulat


def test_the_library_is_imported_in_a_second_without_what_studies_and_books_need():
    found = json.loads(
        python(
            "import json, sys, time; from softwave_min import *\n"
            "print(json.dumps([time.process_time(), list(sys.modules)]))"
        )
    )
    assert HEAVY.isdisjoint(found[1])
    assert found[0] < 1.0


def test_who_looks_at_waves_alone_loads_no_controller():
    """A notebook is stale by what it has loaded."""
    loaded = python("import sys, softwave_min as sw; sw.Sea; print(*sys.modules)").split()
    assert "softwave_min.waves.field" in loaded
    assert not [name for name in loaded if name.startswith("softwave_min.control")]


def requirements(lines):
    return {canonicalize_name(Requirement(line).name) for line in lines}


def test_the_lock_has_what_the_package_and_its_extras_need():
    asked = (ROOT / "requirements.in").read_text().splitlines()
    asked = [line for line in asked if line and not line.startswith("#")]
    extras = PROJECT["optional-dependencies"]
    needed = [*PROJECT["dependencies"], *(one for extra in extras.values() for one in extra)]
    assert sorted(asked, key=str.lower) == sorted(needed, key=str.lower)
    assert set(extras) == {"studies", "cluster", "book", "test"}
    locked = re.findall(r"(?m)^([\w.-]+)==", (ROOT / "environment.lock").read_text())
    assert requirements(needed) <= requirements(locked)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """An environment that holds the wheel and what it says it needs, and nothing else."""
    folder = tmp_path_factory.mktemp("wheel")
    python(f"import hatchling.build; hatchling.build.build_wheel({str(folder)!r})")
    venv.create(folder / "venv", symlinks=True)
    interpreter = folder / "venv" / "bin" / "python"
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(python(where, interpreter=interpreter).strip())
    (wheel,) = folder.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(site)
    (own,) = importlib.metadata.distributions(path=[str(site)])
    waiting, known = list(own.requires), set()
    while waiting:
        one = Requirement(waiting.pop())
        if one.name in known or (one.marker and not one.marker.evaluate({"extra": ""})):
            continue
        known.add(one.name)
        found = importlib.metadata.distribution(one.name)
        waiting += found.requires or []
        for top in {file.parts[0] for file in found.files} - {"..", "__pycache__"}:
            (site / top).symlink_to(found.locate_file(top))
    return interpreter, folder, site


EXAMPLE = """
from dataclasses import replace
import softwave_min as sw
parameters = sw.load_parameters()
short = replace(parameters, simulation=replace(parameters.simulation, duration=2.0))
sea = sw.Sea.random(parameters.sea, parameters.fluid.gravity)
found = sw.compare(short, sea, (0.7, -3.7))
print(found.errors())
try:
    found.plot()
except ImportError as error:
    print(error)
"""


def test_a_wheel_alone_compares_controllers_in_the_example_sea(installed):
    interpreter, folder, site = installed
    before = {path for path in site.rglob("*") if "__pycache__" not in path.parts}
    own = {"folder": folder, "XDG_CACHE_HOME": folder / "cache"}
    printed = python(EXAMPLE, interpreter=interpreter, **own)
    here = python(EXAMPLE).splitlines()
    _, baseline, nmpc, *missing = printed.splitlines()
    assert [baseline, nmpc] == here[1:3]
    assert missing == ["plot() and animate() need matplotlib: pip install 'softwave-min[book]'"]
    libraries = list((folder / "cache").rglob("*.so"))
    assert len(libraries) == (compiler() is not None)
    assert before == {path for path in site.rglob("*") if "__pycache__" not in path.parts}


def test_the_experiments_ask_for_the_projects_folder_in_one_line(installed):
    interpreter, folder, _ = installed
    answer = command(interpreter, "-m", "softwave_min", "list", folder=folder)
    assert (answer.returncode, answer.stdout, answer.stderr.count("\n")) == (2, "", 1)
    assert "project's folder" in answer.stderr


def test_an_editable_install_brings_no_copy_of_the_data(tmp_path):
    python(f"import hatchling.build; hatchling.build.build_editable({str(tmp_path)!r})")
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert [name for name in names if ".dist-info/" not in name] == ["_softwave_min.pth"]


# --- make and pytest as anyone would type them ------------------------------------------


def test_every_line_of_a_recipe_is_a_command_by_itself():
    """GNU make 3.81, which macOS ships, gives each line to a shell of its own."""
    text = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"(?m)^([a-z]+):.*##", text)) - {"lock"}  # which needs uv
    for choice in ("UV=uv", "UV="):
        recipes = command("make", "-n", "-B", *targets, choice, f"PYTHON={sys.executable}").stdout
        assert len(recipes.splitlines()) > len(targets)
        for line in set(recipes.replace("\\\n", " ").splitlines()):
            assert command("sh", "-n", "-c", line).returncode == 0, line
        assert all((ROOT / name).is_file() for name in re.findall(r"[\w/]+\.py\b", recipes))
    for newer in (".ONESHELL", ".SHELLFLAGS", "!=", "$(file"):  # than 3.81
        assert newer not in re.sub(r"(?m)^(#|\t).*", "", text)


def test_make_record_says_that_results_and_notebooks_are_to_be_written():
    recipe = command("make", "-n", "record").stdout
    assert "-m softwave_min run --record\n" in recipe
    assert "notebooks/execute.py --record\n" in recipe


def test_nbval_passes_over_what_may_differ_without_being_told_to(tmp_path):
    """Wall times and the points of a picture, under the options in pyproject.toml alone."""
    cell = {
        "cell_type": "code", "execution_count": 1, "id": "one", "metadata": {},
        "source": "print('1.5 s of wall time')\nprint('<?xml version=\"1.0\"?> 1.1 </svg>')",
        "outputs": [{
            "name": "stdout", "output_type": "stream",
            "text": "2.5 s of wall time\n<?xml version=\"1.0\"?> 1.2 </svg>\n",
        }],
    }  # fmt: skip
    kernel = {"kernelspec": {"display_name": "Python 3", "name": "python3"}}
    notebook = {"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    (tmp_path / "one.ipynb").write_text(json.dumps(notebook))
    options = ("--nbval", "-c", "pyproject.toml", tmp_path)
    answer = command(sys.executable, "-m", "pytest", *options)
    assert "1 passed" in answer.stdout, answer.stdout
