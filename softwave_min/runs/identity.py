"""What determines a result: one kind of identity for runs, tables, figures, notebooks, the book.

- A run: its function, its parameters, the source that the function rests on, and the locked
  versions of the libraries that it computes with. It reads no file.
- Tables and figures, besides: the files that were read on the way, each of which its reader
  noted (`softwave_min.data`).

Results keep the parts of their identity, so that what is stale can say why.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from softwave_min.data import ROOT
from softwave_min.parameters import ParameterSet
from softwave_min.runs.source import imported_libraries, source_digests

NUMERICAL = ("casadi", "cvxpy", "numpy", "scipy")
"""Distributions whose versions decide what a run computes, where it imports them."""
RESULTS = "results/"
"""Begins the name of a file in the folder of the results, wherever that lies."""
QUOTED = 3
"""Most files that are named to say why a result is stale."""
_PLAIN: TypeAdapter[Any] = TypeAdapter(Any)

Part = str | Mapping[str, str]


@dataclass(frozen=True)
class Identity:
    """What determines a result, in parts."""

    parts: Mapping[str, Part]
    """Each a digest, or digests or versions by name."""

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the parts."""
        return digest(self.parts)

    def changes(self, recorded: Mapping[str, Part] | None) -> list[str]:
        """What is another thing than in the parts that were recorded; empty if nothing is."""
        if not recorded:
            return ["not recorded"]
        return [
            _change(name, self.parts.get(name, {}), recorded.get(name, {}))
            for name in sorted({*self.parts, *recorded})
            if self.parts.get(name) != recorded.get(name)
        ]


def _change(name: str, now: Part, recorded: Part) -> str:
    if isinstance(now, str) or isinstance(recorded, str):
        return name
    changed = sorted(key for key in {*now, *recorded} if now.get(key) != recorded.get(key))
    more = f" and {len(changed) - QUOTED} more" if len(changed) > QUOTED else ""
    return f"{name} ({', '.join(changed[:QUOTED])}{more})"


def as_plain(parameters: Any) -> Any:
    """Turn a tree of dataclasses into what JSON can hold."""
    return _PLAIN.dump_python(parameters, mode="json")


def digest(*parts: Any) -> str:
    """SHA-256 over the canonical JSON of ``parts``, in hexadecimal."""
    text = json.dumps([as_plain(part) for part in parts], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def run_identity(compute: Callable[[Any], Any], parameters: Any) -> Identity:
    """What determines the value of a function of its parameters."""
    modules = modules_of_run(compute, parameters)
    return Identity(
        {
            "function": f"{compute.__module__}.{compute.__qualname__}",
            "parameters": digest(parameters),
            "source": source_digests(*modules),
            "lock": locked(*imported_libraries(*modules).intersection(NUMERICAL)),
        }
    )


def modules_of_run(compute: Callable[[Any], Any], parameters: Any) -> tuple[str, ...]:
    """The function's module, and those that it imports because of its parameters' values."""
    # Imported here: it brings the solvers, and who compares notebooks needs none.
    from softwave_min.simulation.backends import modules_of  # noqa: PLC0415

    of_values = {name for one in _sets_in(parameters) for name in modules_of(one)}
    return (compute.__module__, *sorted(of_values))


def _sets_in(tree: Any) -> Iterator[ParameterSet]:
    """Every parameter set in a tree of dataclasses and tuples of them."""
    if isinstance(tree, ParameterSet):
        yield tree
    elif is_dataclass(tree):
        for one in fields(tree):
            yield from _sets_in(getattr(tree, one.name))
    elif isinstance(tree, tuple) and tree and is_dataclass(tree[0]):
        for value in tree:
            yield from _sets_in(value)


@cache
def _versions() -> dict[str, str]:
    """Every distribution in the lock: its version, or one for each range of Pythons."""
    lock = ROOT / "environment.lock"
    text = lock.read_text(encoding="utf-8") if lock.is_file() else ""
    found: dict[str, list[str]] = {}
    for name, version in re.findall(r"(?m)^([\w.-]+)==([^\\\n]+)", text):
        found.setdefault(name, []).append(version.strip())
    return {name: ", ".join(versions) for name, versions in found.items()}


def locked(*names: str) -> dict[str, str]:
    """Versions in ``environment.lock`` of the named distributions, where they are in it."""
    versions = _versions()
    return {name: versions[name] for name in sorted(names) if name in versions}


def file_digests(paths: Iterable[Path], results: Path) -> dict[str, str]:
    """SHA-256 of files by their names in the project; ``results`` stands for ``results/``."""
    return named_digests((_name(path.resolve(), results.resolve()) for path in paths), results)


def named_digests(names: Iterable[str], results: Path) -> dict[str, str]:
    """SHA-256 of the files that have these names; empty for one that is not there."""
    return {name: _file_digest(_path(name, results)) for name in sorted(names)}


def _name(path: Path, results: Path) -> str:
    if path.is_relative_to(results):
        return RESULTS + path.relative_to(results).as_posix()
    return (path.relative_to(ROOT) if path.is_relative_to(ROOT) else path).as_posix()


def _path(name: str, results: Path) -> Path:
    return results / name.removeprefix(RESULTS) if name.startswith(RESULTS) else ROOT / name


def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
