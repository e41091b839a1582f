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


def shown(text):
    output = new_output("display_data", {"text/html": text})
    return executed(new_code_cell("show()", execution_count=1, outputs=[output]))


FAULTY = {
    "not executed": executed(new_code_cell("1 + 1")),
    "out of order": executed(
        new_code_cell("a = 1", execution_count=2), new_code_cell("a", execution_count=1)
    ),
    "empty": executed(new_markdown_cell(" ")),
    "error": executed(
        new_code_cell(
            "a", execution_count=1, outputs=[new_output("error", ename="NameError", evalue="a")]
        )
    ),
    "stderr": executed(
        new_code_cell(
            "a", execution_count=1, outputs=[new_output("stream", name="stderr", text="50 %")]
        )
    ),
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


def test_a_notebook_is_current_once_executed_and_comes_out_the_same_again(write, tmp_path):
    path = write("a = 2", "print('one')\nprint('two')\na ** 10")
    assert not executor.is_current(path, tmp_path)
    executor.execute(path, tmp_path)
    assert executor.is_current(path, tmp_path)
    first = path.read_bytes()
    assert faults(nbformat.read(path, as_version=4)) == []
    (tmp_path / path.stem).unlink()
    executor.execute(path, tmp_path)
    assert path.read_bytes() == first


@pytest.mark.parametrize("edit", ["a comment", "its outputs"])
def test_an_edit_makes_one_notebook_stale_and_no_other(write, tmp_path, edit):
    path, other = write("print(1)"), write("print(1)", name="other")
    for each in (path, other):
        executor.execute(each, tmp_path)
    notebook = nbformat.read(path, as_version=4)
    if edit == "a comment":
        notebook.cells[0].source += "  # one"
    else:
        notebook.cells[0].outputs = []
    path.write_text(nbformat.writes(notebook))
    assert not executor.is_current(path, tmp_path)
    assert executor.is_current(other, tmp_path)


def test_a_failure_names_the_cell_and_leaves_the_file_alone(write, tmp_path):
    path = write("a = 1", "a / 0")
    before = path.read_bytes()
    with pytest.raises(executor.ExecutionError, match=r"(?s)a / 0.*ZeroDivisionError"):
        executor.execute(path, tmp_path)
    assert path.read_bytes() == before
    assert not executor.is_current(path, tmp_path)


@pytest.fixture
def drag(tmp_path, monkeypatch):
    """Set the drag coefficient in a copy of the parameters."""
    folder = tmp_path / "data"
    text = (executor.parameters.data_folder() / "parameters/physical.toml").read_text()
    (folder / "parameters").mkdir(parents=True)
    monkeypatch.setattr(executor.parameters, "data_folder", lambda: folder)

    def set_drag(coefficient):
        changed = re.sub(r"(?m)^(drag_coefficient = )[\d.]+", rf"\g<1>{coefficient}", text)
        (folder / "parameters/physical.toml").write_text(changed)

    return set_drag


LOAD = """
from softwave_min.data import data_folder
from softwave_min.parameters import load_parameters
nominal = load_parameters(data_folder() / "parameters" / "physical.toml")
"""


@pytest.mark.parametrize(
    ("code", "depends"),
    [
        ("nominal.fluid.drag_coefficient", True),
        ("nominal.fluid.gravity", False),
        ("nominal.sea.peak_period", False),
        ("from softwave_min.simulation import simulate\nsimulate(nominal)", True),
        ("from softwave_min.waves.dispersion import wave_number\nwave_number(1, 20)", False),
    ],
)
def test_drag_determines_the_notebooks_that_read_it(write, drag, code, depends):
    path = write(LOAD, code)
    drag(1.1)
    before = executor.state(path)
    drag(1.2)
    assert (executor.state(path) != before) == depends


def test_results_determine_the_notebooks_that_name_their_experiment(write, tmp_path, monkeypatch):
    reader = write("from softwave_min.runs.store import Store\nStore('spectra')")
    other = write("from softwave_min.runs.store import Store\nStore('none')", name="other")
    monkeypatch.setattr(executor, "results_folder", lambda: tmp_path)
    before = executor.state(reader), executor.state(other)
    (tmp_path / "spectra").mkdir()
    (tmp_path / "spectra/curves.csv").write_text("f,S\n")
    assert executor.state(reader) != before[0]
    assert executor.state(other) == before[1]


def test_source_determines_the_notebooks_that_rest_on_it(write, tmp_path, monkeypatch):
    path = write("import softwave_min.simulation")
    module = tmp_path / "simulation.py"
    monkeypatch.setattr(
        executor,
        "source_files",
        lambda names: [module] if "softwave_min.simulation" in names else [],
    )
    module.write_text("step = 1")
    before = executor.state(path)
    module.write_text("step = 2")
    assert executor.state(path) != before
