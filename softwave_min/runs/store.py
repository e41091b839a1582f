"""Results on disk: written whole, with what they came from, and judged fresh or stale.

``results/<experiment>/`` holds

- ``<table>.csv`` and ``<figure>.svg``, committed;
- ``provenance.json``, committed: what determined them, and on what they ran.

``results/runs/``, not committed, holds

- ``<identity>.npz``: one file per run, whichever experiments it belongs to, so that an
  interrupted experiment resumes and a fresh clone computes everything itself;
- ``tables/<experiment>/``: the tables as they were made here. Where they agree with the
  committed ones, those stay as they are.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from softwave_min.data import ROOT, note_read
from softwave_min.runs.experiment import Arrays, Run
from softwave_min.runs.identity import as_plain

if TYPE_CHECKING:
    import pandas as pd

LIBRARIES = ("casadi", "cvxpy", "matplotlib", "numpy", "pandas", "scipy")
SIGNIFICANT_DIGITS = 10
PROVENANCE = "provenance.json"
UNFINISHED = ".writing-"
"""Prefix of a file that is being written; what remains of it was never finished."""
HOUR = 3600.0
KEPT = 14 * 24 * HOUR
"""How long a run is kept that nobody asks for, in s: it may be of another parameter set, or of a
definition that comes back."""


def results_folder() -> Path:
    """Folder ``results/``; the environment variable SOFTWAVE_RESULTS names another."""
    return Path(os.environ.get("SOFTWAVE_RESULTS", ROOT / "results")).resolve()


@dataclass(frozen=True)
class Store:
    """The results of one experiment."""

    experiment: str
    root: Path = field(default_factory=results_folder)

    @property
    def folder(self) -> Path:
        """``results/<experiment>``."""
        return self.root / self.experiment

    @property
    def made(self) -> Store:
        """The tables as they were made here."""
        return Store(self.experiment, self.root / "runs" / "tables")

    def latest(self) -> Store:
        """The tables made here where they are of the same inputs as those that are committed."""
        here, committed = (one.provenance().get("identity", {}) for one in (self.made, self))
        return self.made if here and here["tables"] == committed.get("tables") else self

    def run_path(self, run: Run) -> Path:
        """File of one run."""
        return self.root / "runs" / f"{run.identity}.npz"

    def has(self, run: Run) -> bool:
        """Whether the run is here, and whole; to ask for it is to use it."""
        path = self.run_path(run)
        try:
            content: str = self.run_record(run)["content"]
            same = content == sha256(path.read_bytes()).hexdigest()
        except (OSError, ValueError, KeyError):
            return False
        for used in (path, path.with_suffix(".json")):
            with contextlib.suppress(OSError):  # of another user
                os.utime(used)
        return same

    def save_run(self, run: Run, arrays: Arrays, record: Mapping[str, Any]) -> None:
        """Write a run's arrays; ``record`` is their provenance."""
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **arrays)
        content, path = buffer.getvalue(), self.run_path(run)
        # First the record: arrays without it would count as computed.
        mark = {"content": sha256(content).hexdigest()}
        write_atomically(path.with_suffix(".json"), _json({**record, **mark}))
        write_atomically(path, content)

    def tidy(self) -> None:
        """Drop what dead writers left of the tables and figures."""
        for folder in (self.folder, self.made.folder):
            _drop_unfinished(folder)

    def files(self) -> list[Path]:
        """Tables, figures and provenance: all but the runs."""
        if not self.folder.is_dir():
            return []
        found = (path for path in self.folder.iterdir() if path.is_file())
        return sorted(path for path in found if not path.name.startswith(UNFINISHED))

    def run_record(self, run: Run) -> dict[str, Any]:
        """Provenance of a computed run."""
        text = self.run_path(run).with_suffix(".json").read_text(encoding="utf-8")
        record: dict[str, Any] = json.loads(text)
        return record

    def load_run(self, run: Run) -> dict[str, NDArray[Any]]:
        """Read a run's arrays.

        Raises
        ------
        FileNotFoundError
            If the run was not computed, or not as it is defined now.
        """
        path = self.run_path(run)
        if not self.has(run):
            raise FileNotFoundError(
                f"{self.experiment}/{run.name} is not computed or stale: run 'make results'"
            )
        note_read(path)
        with np.load(path) as archive:
            return dict(archive)

    def write_table(self, stem: str, table: pd.DataFrame) -> None:
        """Write ``<stem>.csv``."""
        write_atomically(self.folder / f"{stem}.csv", table_text(table).encode())

    def read_table(self, stem: str) -> pd.DataFrame:
        """Read ``<stem>.csv``."""
        path = self.folder / f"{stem}.csv"
        note_read(path)
        return read_table(path)

    def table_text(self, stem: str) -> str:
        """``<stem>.csv`` as it is written."""
        return (self.folder / f"{stem}.csv").read_text(encoding="utf-8")

    def stems(self) -> list[str]:
        """Stems of the tables."""
        return sorted(path.stem for path in self.folder.glob("*.csv"))

    def file_digests(self) -> dict[str, str]:
        """SHA-256 of every file but the runs and the provenance."""
        return {
            path.name: sha256(path.read_bytes()).hexdigest()
            for path in self.files()
            if path.name != PROVENANCE
        }

    def write_provenance(self, record: Mapping[str, Any]) -> None:
        """Write ``provenance.json``."""
        write_atomically(self.folder / PROVENANCE, _json(record))

    def provenance(self) -> dict[str, Any]:
        """Read ``provenance.json``; empty where there is none."""
        path = self.folder / PROVENANCE
        if not path.is_file():
            return {}
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return record


def table_text(table: pd.DataFrame) -> str:
    """CSV text of a table, floats to ten significant digits."""
    digits = f"%.{SIGNIFICANT_DIGITS}g"
    return str(table.to_csv(index=False, float_format=digits, lineterminator="\n"))


def read_table(source: Path | io.StringIO) -> pd.DataFrame:
    """Read a table that ``table_text`` wrote."""
    import pandas as pd  # noqa: PLC0415 - takes half a second, and most who look need no table

    return pd.read_csv(source)


def tidy_runs(root: Path) -> None:
    """Drop the runs in a results folder that nobody asked for in a long time.

    And what dead writers left of them. All experiments share these runs: once for all is enough.
    """
    runs = root / "runs"
    _drop(runs.glob("*.*"), before=time.time() - KEPT)
    _drop_unfinished(runs)


def _drop_unfinished(folder: Path) -> None:
    _drop(folder.glob(f"{UNFINISHED}*"), before=time.time() - HOUR)  # no writer takes that long


def _drop(paths: Iterable[Path], before: float) -> None:
    """Remove the files that were last written or used before a time."""
    for path in paths:
        with contextlib.suppress(FileNotFoundError):
            if path.stat().st_mtime < before:
                path.unlink()


def _json(record: Mapping[str, Any]) -> bytes:
    text = json.dumps(as_plain(dict(record)), indent=1, sort_keys=True, allow_nan=False)
    return (text + "\n").encode()


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that no reader ever sees a part of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with _temporary_beside(path) as (handle, temporary):
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)


@contextlib.contextmanager
def _temporary_beside(path: Path) -> Iterator[tuple[int, str]]:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=UNFINISHED)
    try:
        yield handle, temporary
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)


@cache
def repository_state() -> dict[str, Any]:
    """Commit of the source, and whether all but results and notebooks was clean."""
    try:
        commit = _git("rev-parse", "HEAD")
        changes = _git("status", "--porcelain", "--", ".", ":!results", ":!notebooks")
    except (OSError, subprocess.CalledProcessError):
        return {"commit": None, "clean": None}
    return {"commit": commit, "clean": not changes}


def _git(*arguments: str) -> str:
    answer = subprocess.run(
        ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True
    )
    return answer.stdout.strip()


@cache
def machine() -> dict[str, Any]:
    """Platform, processor count and versions that a result was computed with."""
    return {
        "platform": f"{platform.system()} {platform.machine()}",
        "processors": os.cpu_count(),
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in LIBRARIES},
    }
