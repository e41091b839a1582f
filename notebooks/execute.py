"""Execute the notebooks whose inputs changed, and write those whose outputs did.

``.build/notebooks/<stem>.json`` keeps what a notebook was executed with here: its code and
outputs, the files of ``data/`` and ``results/`` that it read, the source that it loaded, and the
locked libraries. Where outputs agree but for what may differ between two executions, the file
stays as it is.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from configparser import ConfigParser
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nbformat import NotebookNode

from softwave_min.data import PACKAGE, READ_LOG, ROOT
from softwave_min.runs.identity import (
    NUMERICAL,
    Identity,
    digest,
    file_digests,
    locked,
    named_digests,
)
from softwave_min.runs.source import source_digests
from softwave_min.runs.store import results_folder, write_atomically

STAMPS = ROOT / ".build" / "notebooks"
MAY_DIFFER = ROOT / "tests" / "nbval_sanitize.cfg"
"""What of the outputs may differ without being wrong, for nbval as well."""
CELL_TIMEOUT = 300
"""Longest that one cell may take, in s."""
AT_ONCE = 2
"""Notebooks that are executed side by side."""
LIBRARIES = (*NUMERICAL, "ipykernel", "matplotlib", "nbclient", "pandas")
"""Distributions whose versions decide what a notebook shows."""
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"file_extension": ".py", "name": "python", "pygments_lexer": "ipython3"},
}
"""The same on every machine and for every version of Python."""
CELL_METADATA = ("mystnb", "tags")
"""What an author says of a cell; the rest is what an editor left behind."""
NOTE_MODULES = f"""
import os, sys
with open(os.environ[{READ_LOG!r}], "a", encoding="utf-8") as log:
    for name, module in sorted(sys.modules.items()):
        if name.startswith("{PACKAGE.name}."):
            print(module.__file__, file=log)
"""
"""A last cell, which is not kept: what a notebook loaded is what it rests on."""


class ExecutionError(RuntimeError):
    """A cell failed, took too long or killed its kernel."""


def changes(path: Path, stamps: Path = STAMPS) -> list[str] | None:
    """What is another than when the notebook was executed here; None if it never was."""
    stamp = _stamp(path, stamps)
    if not stamp.is_file():
        return None
    recorded = json.loads(stamp.read_text(encoding="utf-8"))
    read = named_digests(recorded["parts"]["data"], results_folder())
    return _identity(path, recorded["modules"], read).changes(recorded["parts"])


def _stamp(path: Path, stamps: Path) -> Path:
    return stamps / f"{path.stem}.json"


def _identity(path: Path, modules: list[str], read: dict[str, str]) -> Identity:
    """What determines a notebook's outputs, itself included, if it loads and reads these."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    return Identity(
        {
            "cells": digest(
                [[cell["source"], cell["metadata"].get("tags"), cell["outputs"]] for cell in code]
            ),
            "source": source_digests(*modules),
            "data": read,
            "lock": locked(*LIBRARIES),
        }
    )


def execute(path: Path, stamps: Path = STAMPS, *, record: bool = False) -> float:
    """Execute a notebook in its own folder; return the seconds it took.

    It is written if its outputs are other ones; with ``record``, also if they only differ in
    what may differ.

    Raises
    ------
    ExecutionError
        With the cell that failed; the file is left as it was.
    """
    import nbformat  # here: to import these takes longer than to find all notebooks current

    notebook = nbformat.read(path, as_version=4)
    start = time.perf_counter()
    with TemporaryDirectory() as folder:
        log = Path(folder, "read")
        _run(notebook, path.parent, log)
        read = {Path(line) for line in log.read_text(encoding="utf-8").splitlines()}
    seconds = time.perf_counter() - start
    normalise(notebook)
    content = (nbformat.writes(notebook).rstrip("\n") + "\n").encode()
    former = nbformat.read(path, as_version=4)
    if content != path.read_bytes() and (record or sanitised(notebook) != sanitised(former)):
        write_atomically(path, content)
    sources = {one for one in read if one.is_relative_to(PACKAGE) and one.suffix == ".py"}
    modules = sorted(
        ".".join(one.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for one in sources
    )
    identity = _identity(path, modules, file_digests(read - sources, results_folder()))
    stamp = json.dumps({"modules": modules, "parts": identity.parts}, indent=1)
    write_atomically(_stamp(path, stamps), stamp.encode())
    return seconds


def _run(notebook: NotebookNode, folder: Path, log: Path) -> None:
    """Execute all cells; the log has the files that they read and the modules they loaded."""
    from nbclient import NotebookClient
    from nbclient.exceptions import CellControlSignal
    from nbformat.v4 import new_code_cell
    from traitlets.config import Config

    client = NotebookClient(
        notebook,
        config=Config(KernelManager={"transport_encryption": "auto"}),
        timeout=CELL_TIMEOUT,
        kernel_name=METADATA["kernelspec"]["name"],
        resources={"metadata": {"path": str(folder)}},
        record_timing=False,
        coalesce_streams=True,
    )
    notebook.cells.append(new_code_cell(NOTE_MODULES))
    try:
        client.execute(env={**os.environ, READ_LOG: str(log)})
    except (CellControlSignal, RuntimeError) as failure:
        raise ExecutionError(str(failure)) from None
    notebook.cells.pop()


def sanitised(tree: Any) -> Any:
    """A notebook, or a part of it, without what may differ between two executions."""
    if isinstance(tree, dict):
        # Pictures hang on rounding and on wall times; what matters in them is asserted.
        return {key: sanitised(tree[key]) for key in tree if not key.startswith("image/")}
    if isinstance(tree, list):
        return [sanitised(value) for value in tree]
    if isinstance(tree, str):
        for pattern, replacement in _may_differ():
            tree = pattern.sub(replacement, tree)
    return tree


@cache
def _may_differ() -> list[tuple[re.Pattern[str], str]]:
    config = ConfigParser(interpolation=None)
    config.read(MAY_DIFFER, encoding="utf-8")
    return [(re.compile(config[one]["regex"]), config[one]["replace"]) for one in config.sections()]


def normalise(notebook: NotebookNode) -> None:
    """Drop what differs between machines and editors."""
    notebook.metadata = METADATA
    for cell in notebook.cells:
        cell.metadata = {key: cell.metadata[key] for key in CELL_METADATA if key in cell.metadata}


def report_execution(path: Path, *, record: bool) -> bool:
    """Execute a notebook unless it is current; print what happened; return whether it is now."""
    if changes(path) == [] and not record:
        print(f"{path.stem}: up to date")
        return True
    try:
        print(f"{path.stem}: executed in {execute(path, record=record):.1f} s", flush=True)
    except ExecutionError as failure:
        print(f"{path.stem}: failed\n{failure}", file=sys.stderr, flush=True)
        return False
    return True


def report_stale(path: Path) -> bool:
    """Print why a notebook, once executed here, is stale; return whether it is well."""
    why = changes(path)
    if why:
        print(f"{path.stem}: stale: {', '.join(why)}; run 'make notebooks'", file=sys.stderr)
    return not why


def main() -> int:
    """Run the command line; the exit status is 1 if a notebook failed or is stale."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stem", nargs="*", help="notebooks to look at; all if none is named")
    manner = parser.add_mutually_exclusive_group()
    manner.add_argument("--check", action="store_true", help="execute none; fail if one is stale")
    manner.add_argument(
        "--record", action="store_true", help="execute all, and write whatever differs"
    )
    choice = parser.parse_args()
    paths = {path.stem: path for path in sorted(Path(__file__).parent.glob("*.ipynb"))}
    if unknown := [stem for stem in choice.stem if stem not in paths]:
        parser.error(f"no notebook {unknown[0]!r}; there are: {', '.join(paths)}")
    report = report_stale if choice.check else partial(report_execution, record=choice.record)
    with ThreadPoolExecutor(max_workers=AT_ONCE) as pool:
        done = list(pool.map(report, [paths[stem] for stem in choice.stem or paths]))
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main())
