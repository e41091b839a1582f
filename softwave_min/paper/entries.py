"""Single entries of the files in ``data/``, by name: what one file says, another refers to."""

from __future__ import annotations

from typing import Any

from softwave_min.data import data_folder, read_toml


def data_entry(file: str, name: str) -> Any:
    """An entry of a file in ``data/`` by its dotted name; positions in lists count from 0.

    Raises
    ------
    LookupError
        If there is no such entry.
    """
    found: Any = read_toml(data_folder() / file)
    for part in name.split("."):
        found = found[int(part) if isinstance(found, list) else part]
    return found


def paper_entry(place: str) -> Any:
    """An entry of a file in ``data/paper/``: ``poses:P1``, ``error_ratio:reduction.W3.largest``."""
    file, name = place.split(":")
    return data_entry(f"paper/{file}.toml", name)
