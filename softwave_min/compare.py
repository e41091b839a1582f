"""How the tables in ``results/`` compare with the committed ones."""

from __future__ import annotations

import io
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from softwave_min.identity import ROOT
from softwave_min.store import read_table

__all__ = ["Comparison", "committed_table", "compare_tables"]

RELATIVE_TOLERANCE = 1e-4
ABSOLUTE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Comparison:
    """Outcome for one table."""

    table: str
    agrees: bool
    text: str
    """One line: what was found."""


def committed_table(experiment: str, stem: str) -> pd.DataFrame | None:
    """Table at the last commit, or None where there is no such commit or table."""
    try:
        answer = subprocess.run(
            ["git", "-C", str(ROOT), "show", f"HEAD:results/{experiment}/{stem}.csv"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return read_table(io.StringIO(answer.stdout))


def compare_tables(name: str, ours: pd.DataFrame, committed: pd.DataFrame | None) -> Comparison:
    """Compare two tables cell by cell.

    Text and whole numbers must be equal; other numbers agree within 1e-4 relative
    or 1e-6 absolute, which leaves room for other processors and compilers.
    """
    if committed is None:
        return Comparison(name, agrees=True, text="no committed table to compare with")
    if list(ours.columns) != list(committed.columns) or len(ours) != len(committed):
        return Comparison(name, agrees=False, text="other columns or another number of rows")
    if ours.equals(committed):
        return Comparison(name, agrees=True, text=f"{len(ours)} rows, identical")
    worst, where, agrees = 0.0, "", True
    for column in ours.columns:
        a, b = ours[column], committed[column]
        if not pd.api.types.is_float_dtype(a) or not pd.api.types.is_float_dtype(b):
            if not a.equals(b):
                return Comparison(name, agrees=False, text=f"column {column} differs")
            continue
        x, y = a.to_numpy(float), b.to_numpy(float)
        close = np.isclose(x, y, rtol=RELATIVE_TOLERANCE, atol=ABSOLUTE_TOLERANCE, equal_nan=True)
        agrees &= bool(close.all())
        relative = float(np.nanmax(np.abs(x - y) / np.maximum(np.abs(y), ABSOLUTE_TOLERANCE)))
        if relative > worst:
            worst, where = relative, column
    verdict = "agree" if agrees else "DIFFER"
    text = f"{len(ours)} rows {verdict}; largest relative difference {worst:.1e} in {where}"
    return Comparison(name, agrees, text)


def table_stems(folder: Path) -> list[str]:
    """Stems of the tables in an experiment's folder."""
    return sorted(path.stem for path in folder.glob("*.csv"))
