"""Builds the book, ``book/_build/html``, if anything that it is made of has changed.

Any warning is an error. The build starts from nothing each time: pages quote one another's
numbers, and Sphinx does not follow those quotations. Says nothing unless it builds; prints
the builder's own words, and leaves exit status 1, if that fails.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from softwave_min.runs.identity import Identity, file_digests
from softwave_min.runs.source import imported_modules, source_digests

BOOK = Path(__file__).resolve().parent
ROOT = BOOK.parent
PAGES = BOOK / "_build" / "html"
STAMP = ROOT / ".build" / "book" / "made_of.json"
BUILD = ("build", "-W", "-n", "--keep-going", "-q", str(BOOK))
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
MADE = {"_build", "__pycache__", ".ipynb_checkpoints"}
RESULTS = ("*.svg", "*.csv", "*.webm", "*.mp4", "provenance.json")


def ingredients() -> Iterator[Path]:
    """Yield every file that the book is made of."""
    for folder, names, files in os.walk(BOOK):
        names[:] = [name for name in names if name not in MADE]
        yield from (Path(folder, name) for name in files)
    yield from (ROOT / "notebooks").glob("*.ipynb")
    for pattern in RESULTS:
        yield from (ROOT / "results").glob(f"*/{pattern}")
    for quoted in (ROOT / "data", ROOT / "bench" / "results"):
        yield from (path for path in quoted.rglob("*") if path.is_file())
    yield ROOT / "environment.lock"


def identity() -> Identity:
    """What determines the pages: their ingredients, and the source that the extensions call."""
    extensions = (path.read_text(encoding="utf-8") for path in (BOOK / "_ext").glob("*.py"))
    called = {name for text in extensions for name in imported_modules(text)}
    return Identity(
        {
            "files": file_digests(ingredients(), ROOT / "results"),
            "source": source_digests(*sorted(called)),
        }
    )


def is_current() -> bool:
    """Whether the pages were built from the ingredients as they are now."""
    built = (PAGES / "index.html").is_file() and STAMP.is_file()
    return built and not identity().changes(json.loads(STAMP.read_text(encoding="utf-8")))


def build() -> int:
    """Build the pages from nothing; return the builder's exit status."""
    STAMP.unlink(missing_ok=True)
    shutil.rmtree(PAGES.parent, ignore_errors=True)
    made_of = identity()
    command = (str(Path(sys.executable).with_name("jupyter-book")), *BUILD)
    answer = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    if answer.returncode:
        sys.stdout.write(COLOUR.sub("", answer.stdout))
        return 1
    STAMP.parent.mkdir(parents=True, exist_ok=True)
    STAMP.write_text(json.dumps(made_of.parts, indent=1), encoding="utf-8")
    return 0


def main() -> int:
    """Build if needed; return the exit status."""
    if is_current():
        return 0
    status = build()
    outcome = "the book did not build" if status else f"the book is built: {PAGES / 'index.html'}"
    sys.stdout.write(f"{outcome}\n")
    return status


if __name__ == "__main__":
    sys.exit(main())
