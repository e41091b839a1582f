"""What determines a result, as one hash.

A result depends on its parameters, on the source that computes it - the module
and all modules of this package that it imports, directly or not, with the C
sources beside them - and on the locked versions of the libraries.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from softwave_min.data import PACKAGE, ROOT

_PLAIN: TypeAdapter[Any] = TypeAdapter(Any)


def as_plain(parameters: Any) -> Any:
    """Turn a tree of dataclasses into what JSON can hold."""
    return _PLAIN.dump_python(parameters, mode="json")


def digest(*parts: Any) -> str:
    """SHA-256 over the canonical JSON of ``parts``, in hexadecimal."""
    text = json.dumps([as_plain(part) for part in parts], sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def run_identity(compute: Callable[[Any], Any], parameters: Any) -> str:
    """Hash over what determines the value of a function of its parameters."""
    return digest(
        compute.__module__,
        compute.__qualname__,
        parameters,
        source_digest(compute.__module__),
        lock_digest(),
    )


@cache
def lock_digest() -> str:
    """SHA-256 of ``environment.lock``."""
    return hashlib.sha256((ROOT / "environment.lock").read_bytes()).hexdigest()


@cache
def source_digest(*modules: str) -> str:
    """SHA-256 over the sources that the named modules rest on."""
    total = hashlib.sha256()
    for path in source_files(modules):
        total.update(path.relative_to(PACKAGE).as_posix().encode() + b"\0")
        total.update(path.read_bytes() + b"\0")
    return total.hexdigest()


def source_files(modules: Iterable[str]) -> list[Path]:
    """Files of this package that the named modules are made of, sorted."""
    found: set[Path] = set()
    waiting = list(modules)
    while waiting:
        path = _module_path(waiting.pop())
        if path is None or path in found:
            continue
        found.add(path)
        found.update(path.parent.glob("*.[ch]") if path.parent != PACKAGE else ())
        waiting.extend(_imported_by(path))
    return sorted(found)


@cache
def _imported_by(path: Path) -> set[str]:
    return imported_modules(path.read_text(encoding="utf-8"), _module_name(path))


def imported_modules(source: str, module: str = "") -> set[str]:
    """Absolute names that ``source`` imports; ``module`` resolves relative ones."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parent = ".".join(module.split(".")[: -node.level]) + "." if node.level else ""
            base = (parent + (node.module or "")).rstrip(".")
            names.add(base)
            names.update(f"{base}.{alias.name}" for alias in node.names)
    return names


def _module_path(module: str) -> Path | None:
    parts = module.split(".")
    if parts[0] != PACKAGE.name:
        return None
    path = PACKAGE.joinpath(*parts[1:])
    if (path / "__init__.py").is_file():
        return path / "__init__.py"
    source = path.with_suffix(".py")
    return source if source.is_file() else None


def _module_name(path: Path) -> str:
    """Dotted name of a file; ``__init__`` stays, so that one leading dot strips it."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts)
