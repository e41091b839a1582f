"""Execute the notebooks whose inputs changed, and write each one whole.

``.build/notebooks/<stem>`` keeps the hash of a notebook's state: its code and outputs, the
source, data and results that its code names, and the locked libraries. A notebook whose
state is another, or that has none, is not current.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import sys
import time
import tomllib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from IPython.core.inputtransformer2 import TransformerManager

if TYPE_CHECKING:
    from nbformat import NotebookNode

from softwave_min import parameters
from softwave_min.data import PACKAGE, ROOT
from softwave_min.runs.identity import digest, imported_modules, lock_digest, source_files
from softwave_min.runs.store import results_folder, write_atomically
from softwave_min.studies.catalogue import NAMES

STAMPS = ROOT / ".build" / "notebooks"
CELL_TIMEOUT = 300
"""Longest that one cell may take, in s."""
AT_ONCE = 2
"""Notebooks that are executed side by side."""
UNDATED = {"SOURCE_DATE_EPOCH": "0"}
"""Keeps the day of its drawing out of a figure."""
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"file_extension": ".py", "name": "python", "pygments_lexer": "ipython3"},
}
"""The same on every machine and for every version of Python."""
RECORDS = ("calibration", "sensitivity")
"""Folders of results that are not an experiment's."""
CELL_METADATA = ("mystnb", "tags")
"""What an author says of a cell; the rest is what an editor left behind."""


class ExecutionError(RuntimeError):
    """A cell failed, took too long or killed its kernel."""


def is_current(path: Path, stamps: Path = STAMPS) -> bool:
    """Whether the outputs in the file are what its inputs give."""
    stamp = stamps / path.stem
    try:
        return stamp.is_file() and stamp.read_text(encoding="ascii") == state(path)
    except SyntaxError:  # executing it will say where
        return False


def execute(path: Path, stamps: Path = STAMPS) -> float:
    """Execute a notebook in its own folder and write it; return the seconds it took.

    Raises
    ------
    ExecutionError
        With the cell that failed; the file is left as it was.
    """
    import nbformat  # here: to import these takes longer than to find all notebooks current
    from nbclient import NotebookClient
    from nbclient.exceptions import CellControlSignal
    from traitlets.config import Config

    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        config=Config(KernelManager={"transport_encryption": "auto"}),
        timeout=CELL_TIMEOUT,
        kernel_name=METADATA["kernelspec"]["name"],
        resources={"metadata": {"path": str(path.parent)}},
        record_timing=False,
        coalesce_streams=True,
    )
    start = time.perf_counter()
    try:
        client.execute(env={**os.environ, **UNDATED})
    except (CellControlSignal, RuntimeError) as failure:
        raise ExecutionError(str(failure)) from None
    seconds = time.perf_counter() - start
    normalise(notebook)
    content = (nbformat.writes(notebook).rstrip("\n") + "\n").encode()
    if content != path.read_bytes():
        write_atomically(path, content)
    write_atomically(stamps / path.stem, state(path).encode())
    return seconds


def normalise(notebook: NotebookNode) -> None:
    """Drop what differs between machines and editors."""
    notebook.metadata = METADATA
    for cell in notebook.cells:
        cell.metadata = {key: cell.metadata[key] for key in CELL_METADATA if key in cell.metadata}


def state(path: Path) -> str:
    """Hash over a notebook's code and outputs and all that its code rests on."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    cells = [cell for cell in cells if cell["cell_type"] == "code"]
    code = "\n".join(plain_python("".join(cell["source"])) for cell in cells)
    named = words(code)
    experiments = [name for name in (*NAMES, *RECORDS) if name in named]
    sources = source_files([*imported_modules(code), *experiment_modules(experiments)])
    for source in sources:
        # The parameters' own module names every field, and uses none.
        if source.suffix == ".py" and source != Path(parameters.__file__):
            named |= words(source.read_text(encoding="utf-8"))
    return digest(
        [[cell["source"], cell["metadata"].get("tags"), cell["outputs"]] for cell in cells],
        [[file.name, file.read_text(encoding="utf-8")] for file in (*sources, Path(__file__))],
        sorted(data(named)),
        list(results(experiments)),
        lock_digest(),
    )


def plain_python(cell: str) -> str:
    """Source of a cell with its IPython magics turned into Python."""
    return TransformerManager().transform_cell(cell)


def words(code: str) -> set[str]:
    """Attributes, strings and names of modules that occur in the code."""
    found = {part for module in imported_modules(code) for part in module.split(".")}
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.Attribute(attr=word) | ast.Constant(value=str(word)):
                found.add(word)
    return found


def experiment_modules(names: Iterable[str]) -> Iterator[str]:
    """Modules that the registry and the figures find by an experiment's name."""
    for name in names:
        yield f"{PACKAGE.name}.experiments.{name}"
        yield f"{PACKAGE.name}.figures.{name}"


def data(named: set[str]) -> Iterator[tuple[str, Any]]:
    """What ``data/`` holds under the given names: fields of parameter sets, whole files else."""
    folder = parameters.data_folder()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        place = path.relative_to(folder)
        if place.parts[0] == "parameters" and path.stem in parameters.SET_NAMES:
            sections = tomllib.loads(path.read_text(encoding="utf-8"))
            for section in named & sections.keys():
                fields = sections[section]
                used = {field: fields[field] for field in fields if field in named}
                yield f"{place.as_posix()} {section}", used
        elif named & {*place.parts, path.stem}:
            yield place.as_posix(), path.read_bytes().hex()


def results(experiments: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Runs, by the identity in their file's name, and tables and figures of experiments."""
    for name in experiments:
        folder = results_folder() / name
        for path in sorted(folder.glob("runs/*.npz")):
            yield name, path.name
        for path in sorted(path for path in folder.glob("*") if path.suffix in {".csv", ".svg"}):
            yield path.name, path.read_text(encoding="utf-8")


def report_execution(path: Path) -> bool:
    """Execute a notebook unless it is current; print what happened; return whether it is now."""
    if is_current(path):
        print(f"{path.stem}: up to date")
        return True
    try:
        print(f"{path.stem}: executed in {execute(path):.1f} s", flush=True)
    except ExecutionError as failure:
        print(f"{path.stem}: failed\n{failure}", file=sys.stderr, flush=True)
        return False
    return True


def report_stale(path: Path) -> bool:
    """Print whether a notebook, once executed here, is so no more; return whether it is well."""
    if is_current(path) or not (STAMPS / path.stem).is_file():
        return True
    print(f"{path.stem}: stale; run 'make notebooks'", file=sys.stderr)
    return False


def main() -> int:
    """Run the command line; the exit status is 1 if a notebook failed or is stale."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stem", nargs="*", help="notebooks to look at; all if none is named")
    parser.add_argument("--check", action="store_true", help="execute none; fail if one is stale")
    choice = parser.parse_args()
    paths = {path.stem: path for path in sorted(Path(__file__).parent.glob("*.ipynb"))}
    if unknown := [stem for stem in choice.stem if stem not in paths]:
        parser.error(f"no notebook {unknown[0]!r}; there are: {', '.join(paths)}")
    chosen = [paths[stem] for stem in choice.stem or paths]
    with ThreadPoolExecutor(max_workers=AT_ONCE) as pool:
        return (
            0
            if all(list(pool.map(report_stale if choice.check else report_execution, chosen)))
            else 1
        )


if __name__ == "__main__":
    sys.exit(main())
