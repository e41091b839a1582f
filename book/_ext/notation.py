"""The directive ``{notation}``: one group of ``data/notation.toml`` as a table."""

from __future__ import annotations

from pathlib import Path

import myst

from softwave_min.data import data_folder, read_toml

HEADINGS = ("Symbol", "Meaning", "Unit", "Name in the code")


def notation(_: Path, group: str) -> str:
    """The symbols of a group."""
    symbols = read_toml(data_folder() / "notation.toml")
    if group not in symbols:
        raise LookupError(f"no group {group!r}")
    rows = [
        (f"${one['symbol']}$", _meaning(one), _unit(one["unit"]), _name(one))
        for one in symbols[group]
    ]
    return myst.table(HEADINGS, rows, class_="notation")


def _meaning(symbol: dict[str, str]) -> str:
    """Meaning, and how the paper writes the symbol where it does so otherwise."""
    match symbol.get("paper"):
        case None:
            return symbol["meaning"]
        case "":
            return f"{symbol['meaning']} (not in the paper)"
        case other:
            return f"{symbol['meaning']} (in the paper ${other}$)"


def _unit(unit: str) -> str:
    """A unit written as 'kg/m^3' or 'N m s/rad'."""
    spaced = unit.replace(" ", r"\,")
    return rf"$\mathrm{{{spaced}}}$" if unit else ""


def _name(symbol: dict[str, str]) -> str:
    """Name in the code, after the place where it lives."""
    if "code" not in symbol:
        return ""
    return f"`{symbol['where']}.`{{.notation-place}}`{symbol['code']}`"


setup = myst.extension({"notation": myst.directive(notation, arguments=1)})
