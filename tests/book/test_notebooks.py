"""The committed notebooks are executed, clean and portable; the executor knows what is stale.

That the outputs are right is nbval's to prove: it executes every notebook once more.
"""

from __future__ import annotations

import importlib.util
import json
import re

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook, new_output

from softwave_min.data import ROOT

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))

MACHINE_PATH = re.compile(r"(?<![\w.:/])/(home|root|tmp|Users|work|var|private|opt)/|[A-Z]:\\\\")
ADDRESS = re.compile(r"\b0x[0-9a-f]{6,}\b")
LOADED_FROM_A_HOST = re.compile(
    r"""(?:src|srcset|data|poster)\s*=\s*["']?(?:https?:)?//"""
    r"""|<link\b[^>]*href\s*=\s*["']?(?:https?:)?//"""
    r"""|<(?:use|image)\b[^>]*href\s*=\s*["'](?:https?:)?//"""
    r"""|@import\b[^;]*//|url\(\s*["']?(?:https?:)?//"""
    r"""|!\[[^\]]*\]\(\s*(?:https?:)?//"""
    r"""|(?:fetch|import|require|importScripts)\(\s*["'](?:https?:)?//""",
    re.IGNORECASE,
)


def load_executor():
    spec = importlib.util.spec_from_file_location("execute", ROOT / "notebooks/execute.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


executor = load_executor()


def faults(notebook):
    """What must not be in a committed notebook."""
    found = []
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    if [cell.execution_count for cell in code] != list(range(1, len(code) + 1)):
        found.append("cells not executed once each, from top to bottom")
    if any(not cell.source.strip() for cell in notebook.cells):
        found.append("an empty cell")
    outputs = [output for cell in code for output in cell.outputs]
    if any(output.output_type == "error" for output in outputs):
        found.append("an error among the outputs")
    if any(output.get("name") == "stderr" for output in outputs):
        found.append("a message on stderr")
    shown = json.dumps(outputs)
    if MACHINE_PATH.search(shown + json.dumps(notebook.metadata)):
        found.append("a path of one machine")
    if ADDRESS.search(shown):
        found.append("an address in memory")
    texts = [cell.source for cell in notebook.cells]
    texts += [str(text) for output in outputs for text in output.get("data", {}).values()]
    if any(LOADED_FROM_A_HOST.search(text) for text in texts):
        found.append("something loaded from another host")
    if notebook.metadata != executor.METADATA:
        found.append("metadata of one machine")
    return found


@pytest.mark.filterwarnings("error")  # nbformat mends missing and doubled ids with a warning
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_committed_notebook_is_without_fault(path):
    notebook = nbformat.read(path, as_version=nbformat.NO_CONVERT)
    nbformat.validate(notebook)
    assert faults(notebook) == []


def executed(*cells):
    return new_notebook(cells=list(cells), metadata=executor.METADATA)


def ran(*outputs, count=1):
    return new_code_cell("a", execution_count=count, outputs=list(outputs))


def shown(text):
    return executed(ran(new_output("display_data", {"text/html": text})))


FAULTY = {
    "not executed": executed(new_code_cell("1 + 1")),
    "out of order": executed(ran(count=2), ran(count=1)),
    "empty": executed(new_markdown_cell(" ")),
    "error": executed(ran(new_output("error", ename="NameError", evalue="a"))),
    "stderr": executed(ran(new_output("stream", name="stderr", text="50 %"))),
    "path": shown("/home/ada/softwave/results"),
    "address": shown("&lt;Figure at 0x7f3b5c0d1e50&gt;"),
    "script": shown('<script src="https://cdn.example.org/plot.js"></script>'),
    "style": shown("<style>@import url(//fonts.example.org/a.css)</style>"),
    "picture": executed(new_markdown_cell("![arm](https://example.org/arm.png)")),
    "metadata": new_notebook(metadata={**executor.METADATA, "vscode": {}}),
}


@pytest.mark.parametrize("fault", FAULTY)
def test_each_fault_is_found(fault):
    assert len(faults(FAULTY[fault])) == 1


def test_a_link_is_no_fault():
    linked = executed(new_markdown_cell("[paper](https://arxiv.org/abs/2401.13439)"))
    assert faults(linked) == []


# --- the executor -----------------------------------------------------------------------


@pytest.fixture
def write(tmp_path):
    """Write a notebook of the given cells of code."""

    def write(*sources, name="study"):
        path = tmp_path / f"{name}.ipynb"
        cells = [new_code_cell(text, id=f"cell-{i}") for i, text in enumerate(sources)]
        path.write_text(nbformat.writes(new_notebook(cells=cells)))
        return path

    return write


def is_current(path, stamps):
    return executor.changes(path, stamps) == []


def test_a_notebook_is_current_once_executed_and_comes_out_the_same_until_it_is_edited(
    write, tmp_path
):
    path, other = write("a = 2", "print('one')\nprint('two')\na ** 10"), write(name="other")
    assert executor.changes(path, tmp_path) is None
    for each in (path, other):
        executor.execute(each, tmp_path)
        assert is_current(each, tmp_path)
    first = path.read_bytes()
    assert faults(nbformat.read(path, as_version=4)) == []
    executor.execute(path, tmp_path)
    assert path.read_bytes() == first
    for changed in ({"source": "a = 2  # one"}, {"outputs": [new_output("stream", text="1")]}):
        notebook = nbformat.read(path, as_version=4)
        notebook.cells[0].update(changed)
        path.write_text(nbformat.writes(notebook))
        assert not is_current(path, tmp_path)
        assert is_current(other, tmp_path)
        path.write_bytes(first)


def test_a_committed_notebook_stays_unless_more_than_a_wall_time_differs(write, tmp_path):
    path = write("import time\nprint(f'{time.perf_counter():.6f} s of wall time')")
    executor.execute(path, tmp_path)
    committed = path.read_bytes()
    executor.execute(path, tmp_path)
    assert path.read_bytes() == committed
    assert is_current(path, tmp_path)
    executor.execute(path, tmp_path, record=True)
    assert path.read_bytes() != committed


def test_a_failure_names_the_cell_and_leaves_the_file_alone(write, tmp_path):
    path = write("a = 1", "a / 0")
    before = path.read_bytes()
    with pytest.raises(executor.ExecutionError, match=r"(?s)a / 0.*ZeroDivisionError"):
        executor.execute(path, tmp_path)
    assert path.read_bytes() == before
    assert not is_current(path, tmp_path)


LOADS = """
from pathlib import Path
from softwave_min.data import read_toml
read_toml(Path("read.toml"))
named = "other.toml"
from softwave_min.runs.store import Store
Store("spectra").read_table("curves")
from importlib import import_module
import_module("softwave_min.waves.dispersion")
"""


def test_what_a_notebook_read_and_loaded_and_nothing_else_determines_it(
    write, tmp_path, monkeypatch
):
    for name in ("read", "other"):
        (tmp_path / f"{name}.toml").write_text("drag = 1.1\n")
    monkeypatch.setenv("SOFTWAVE_RESULTS", str(tmp_path))
    (tmp_path / "spectra").mkdir()
    (tmp_path / "spectra/curves.csv").write_text("f,S\n1,2\n")
    path = write(LOADS)
    executor.execute(path, tmp_path)
    stamp = json.loads((tmp_path / "study.json").read_text())
    assert "softwave_min.waves.dispersion" in stamp["modules"]
    assert "softwave_min/control/nmpc.py" not in stamp["parts"]["source"]
    (tmp_path / "other.toml").write_text("drag = 1.2\n")
    assert is_current(path, tmp_path)
    (tmp_path / "read.toml").write_text("drag = 1.2\n")
    assert executor.changes(path, tmp_path) == ["data (results/read.toml)"]
    (tmp_path / "read.toml").write_text("drag = 1.1\n")
    (tmp_path / "spectra/curves.csv").write_text("f,S\n1,3\n")
    assert executor.changes(path, tmp_path) == ["data (results/spectra/curves.csv)"]
