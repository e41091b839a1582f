"""How tables compare with the committed ones: what differs, where, and by how much."""

from __future__ import annotations

import io
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from softwave_min.data import ROOT
from softwave_min.runs.experiment import Tolerance
from softwave_min.runs.store import read_table

if TYPE_CHECKING:
    import pandas as pd

EXACT = Tolerance(0.0, 0.0)
LABELS = 4
"""Most entries of a row that are quoted to say which row it is."""


@dataclass(frozen=True)
class Comparison:
    """Outcome for one table."""

    agrees: bool
    text: str
    """One line: what was found."""
    differences: tuple[str, ...] = ()
    """One line per column that differs."""


@dataclass(frozen=True)
class _Column:
    differs: NDArray[np.bool_]
    """By row."""
    worst: int
    """Row of the largest difference."""
    relative: float
    """The largest relative difference; not a number for text."""
    tolerance: Tolerance


class NoRepositoryError(RuntimeError):
    """There is no commit to compare with."""


def require_commit() -> None:
    """Make sure that there is a commit to compare with.

    Raises
    ------
    NoRepositoryError
        If git is not there, or no repository with a commit is.
    """
    if _git("rev-parse", "--verify", "HEAD") is None:
        raise NoRepositoryError(f"{ROOT}: no commit to compare with: no git, or no repository")


def committed_text(place: Path, stem: str) -> str | None:
    """Table in a folder below ``results/`` at the last commit, None where there is none."""
    return _git("show", f"HEAD:results/{place.as_posix()}/{stem}.csv")


def committed_stems(place: Path) -> list[str]:
    """Stems of the tables in a folder below ``results/`` at the last commit."""
    listed = _git("ls-tree", "--name-only", f"HEAD:results/{place.as_posix()}") or ""
    return sorted(name.removesuffix(".csv") for name in listed.split() if name.endswith(".csv"))


def _git(*arguments: str) -> str | None:
    try:
        answer = subprocess.run(
            ["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return answer.stdout


def compare_texts(
    ours: str, committed: str | None, tolerances: Mapping[str, Tolerance]
) -> Comparison:
    """Compare two tables as they are written; see `compare_tables`."""
    if committed is None:
        return Comparison(agrees=True, text="no committed table to compare with")
    if ours == committed:
        return Comparison(agrees=True, text=f"{len(ours.splitlines()) - 1} rows, identical")
    return compare_tables(
        read_table(io.StringIO(ours)), read_table(io.StringIO(committed)), tolerances
    )


def tolerances_of(tolerances: Mapping[str, Tolerance], stem: str) -> dict[str, Tolerance]:
    """An experiment's tolerances for the columns of one of its tables."""
    common = {key: value for key, value in tolerances.items() if "." not in key}
    prefix = f"{stem}."
    own = {
        key.removeprefix(prefix): value
        for key, value in tolerances.items()
        if key.startswith(prefix)
    }
    return common | own


def compare_tables(
    ours: pd.DataFrame,
    committed: pd.DataFrame,
    tolerances: Mapping[str, Tolerance] | None = None,
) -> Comparison:
    """Compare two tables cell by cell, each column within its tolerance.

    Where none is stated, text and whole numbers must be equal, and other numbers
    agree within `Tolerance()`.
    """
    if shape := _other_shape(ours, committed):
        return Comparison(agrees=False, text=f"DIFFERS: {shape}")
    if ours.equals(committed):
        return Comparison(agrees=True, text=f"{len(ours)} rows, identical")
    columns = {
        str(name): _compare_columns(ours[name], committed[name], (tolerances or {}).get(str(name)))
        for name in ours.columns
    }
    wrong = tuple(
        _said(ours, committed, name, column)
        for name, column in columns.items()
        if column.differs.any()
    )
    largest = max(
        columns, key=lambda name: np.nan_to_num(columns[name].relative, nan=-1.0, posinf=np.inf)
    )
    text = f"{len(ours)} rows {'DIFFER' if wrong else 'agree'}"
    if columns[largest].relative > 0:
        text += f"; largest relative difference {columns[largest].relative:.1e} in {largest}"
    return Comparison(not wrong, text, wrong)


def _other_shape(ours: pd.DataFrame, committed: pd.DataFrame) -> str:
    if list(ours.columns) != list(committed.columns):
        ones = [f"new column {name}" for name in ours.columns if name not in committed.columns]
        ones += [f"no column {name}" for name in committed.columns if name not in ours.columns]
        return ", ".join(ones) or "columns in another order"
    if len(ours) != len(committed):
        return f"{len(ours)} rows, {len(committed)} committed"
    return ""


def _compare_columns(ours: pd.Series, committed: pd.Series, tolerance: Tolerance | None) -> _Column:
    if not (_is_number(ours) and _is_number(committed)):
        same = (ours == committed) | (ours.isna() & committed.isna())
        differs = ~same.to_numpy(bool)
        return _Column(differs, int(differs.argmax()), np.nan, EXACT)
    whole = all(column.dtype.kind in "iu" for column in (ours, committed))
    tolerance = tolerance or (EXACT if whole else Tolerance())
    a, b = ours.to_numpy(float), committed.to_numpy(float)
    same = (a == b) | (np.isnan(a) & np.isnan(b))
    with np.errstate(invalid="ignore"):
        gap = np.where(same, 0.0, np.nan_to_num(np.abs(a - b), nan=np.inf))  # number against none
    size = np.nan_to_num(np.abs(b), posinf=0.0)
    differs = gap > np.maximum(tolerance.relative * size, tolerance.absolute)
    relative = gap / np.maximum(size, max(tolerance.absolute, np.finfo(float).tiny))
    worst = int(np.where(differs, relative, -1.0).argmax() if differs.any() else relative.argmax())
    return _Column(differs, worst, float(relative[worst]), tolerance)


def _is_number(column: pd.Series) -> bool:
    return column.dtype.kind in "iuf"


def _said(ours: pd.DataFrame, committed: pd.DataFrame, name: str, column: _Column) -> str:
    """What of a column differs, where, and by how much."""
    row = column.worst
    a, b = ours[name].iloc[row], committed[name].iloc[row]
    text = f"{name}: {int(column.differs.sum())} of {len(ours)} rows; "
    text += f"row {row + 1}{_label(committed, row, name)}: {a} here, {b} committed"
    if np.isnan(column.relative):
        return text
    allowed = column.tolerance
    return (
        f"{text}, off by {abs(float(a) - float(b)):.1e} ({column.relative:.1e} relative); "
        f"allowed {allowed.absolute:g} or {allowed.relative:g} relative"
    )


def _label(table: pd.DataFrame, row: int, column: str) -> str:
    """The row's text entries, which say what it is about."""
    names = [
        str(name) for name in table.columns if name != column and table[name].dtype.kind != "f"
    ][:LABELS]
    entries = ", ".join(f"{name} {table[name].iloc[row]}" for name in names)
    return f" ({entries})" if entries else ""
