"""The files in ``data/``: where they are, and a note of each one that is read.

What reads a file declares it by reading it: whoever makes a table or a figure records the
files on the way, and the result is stale as soon as one of them has another content.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

READ_LOG = "SOFTWAVE_READ_LOG"
"""Environment variable with a file to which every read is appended: for other processes."""

PACKAGE = Path(__file__).resolve().parent
ROOT = PACKAGE.parent
"""The project's folder, if ``in_project``."""

_recordings: ContextVar[tuple[set[Path], ...]] = ContextVar("recordings", default=())


class ParameterError(ValueError):
    """A parameter is missing, unknown, of the wrong type or out of range."""


def in_project() -> bool:
    """Whether the package lies in its project, and not in a wheel that was made of it."""
    return not (PACKAGE / "data").is_dir()


def data_folder() -> Path:
    """Folder ``data/``: the project's, or the part of it that travels in the wheel."""
    return (ROOT if in_project() else PACKAGE) / "data"


def cache_folder() -> Path:
    """Where what can be made again is kept: in the project, elsewhere in the user's cache."""
    if in_project():
        return ROOT / ".build"
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / PACKAGE.name


@contextmanager
def recording() -> Iterator[set[Path]]:
    """Collect the files that are read within the context."""
    found: set[Path] = set()
    token = _recordings.set((*_recordings.get(), found))
    try:
        yield found
    finally:
        _recordings.reset(token)


def note_read(path: Path) -> None:
    """Note that a file is read."""
    for found in _recordings.get():
        found.add(path.resolve())
    if log := os.environ.get(READ_LOG):
        with open(log, "a", encoding="utf-8") as stream:
            stream.write(f"{path.resolve()}\n")


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    ParameterError
        If the file cannot be read or is not TOML.
    """
    note_read(path)
    try:
        with path.open("rb") as stream:
            return tomllib.load(stream)
    except OSError as error:
        raise ParameterError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: not valid TOML: {error}") from None
