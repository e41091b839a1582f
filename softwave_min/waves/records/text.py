"""Text files of measured waves: their lines, numbers and times, and what is wrong with them."""

from __future__ import annotations

import gzip
import zlib
from datetime import UTC, datetime
from pathlib import Path

from softwave_min.data import ParameterError, note_read


def read_lines(path: Path, encoding: str = "utf-8-sig") -> list[str]:
    """Lines of a text file, plain or compressed (``.gz``).

    Raises
    ------
    ParameterError
        If there is no such file, or it cannot be read, or is no text.
    """
    note_read(path)
    try:
        content = path.read_bytes()
        if path.suffix == ".gz":
            content = gzip.decompress(content)
        return content.decode(encoding).splitlines()
    except FileNotFoundError:
        raise ParameterError(f"{path}: no such file") from None
    except (OSError, EOFError, zlib.error) as error:
        raise ParameterError(f"{path}: cannot be read: {error}") from None
    except UnicodeDecodeError:
        raise ParameterError(f"{path}: not a text file") from None


def number(path: Path, line: int, word: str) -> float:
    """The number that a word of a line is, or a `ParameterError`."""
    try:
        return float(word)
    except ValueError:
        raise ParameterError(f"{path}:{line}: {word!r} is not a number") from None


def universal(time: datetime) -> datetime:
    """The time in UTC, without a zone, as the files write it."""
    return time.astimezone(UTC).replace(tzinfo=None) if time.tzinfo else time
