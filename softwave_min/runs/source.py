"""The source that a module rests on: what it imports, directly or not, and what of it is code.

Found by reading, not by importing. Comments, docstrings and blank lines decide nothing and
are left out, so that a better sentence makes no result stale. What is compared is text, so that
every version of Python finds the same.
"""

from __future__ import annotations

import ast
import hashlib
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from softwave_min.data import PACKAGE, ROOT

DIGITS = 16
"""Of a digest that tells the versions of one file apart."""
_C_COMMENT = re.compile(r"""("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')|/\*.*?\*/|//[^\n]*""", re.DOTALL)


@cache
def source_digests(*modules: str) -> dict[str, str]:
    """Digest of the code of every file that the modules rest on, by its path in the project."""
    return {path.relative_to(ROOT).as_posix(): _digest(path) for path in source_files(modules)}


def source_files(modules: Iterable[str]) -> list[Path]:
    """Files of this package that the named modules are made of, sorted.

    The front door imports most of the package: it counts where it is named, but not where a
    module below it is, which needs nothing of it. Nor do ``runs/``, which keep and compare what
    is computed, determine what that is; their statistics do.
    """
    found: set[Path] = set()
    waiting = list(modules)
    while waiting:
        path = _module_path(waiting.pop())
        if path is None or path in found or _keeps_results(path):
            continue
        found.add(path)
        found.update(path.parent.glob("*.[ch]") if path.parent != PACKAGE else ())
        waiting.extend(name for name in _imported_by(path) if name != PACKAGE.name)
    return sorted(found)


@cache
def imported_libraries(*modules: str) -> frozenset[str]:
    """What else the modules of `source_files` import, by the first part of the name."""
    files = (path for path in source_files(modules) if path.suffix == ".py")
    names = {name.partition(".")[0] for path in files for name in _imported_by(path)}
    return frozenset(names - {PACKAGE.name})


def code_of(text: str, suffix: str = ".py") -> str:
    """A source without comments, docstrings and blank lines."""
    if suffix == ".py":
        text = _without(text, [*_comments(text), *_bare_strings(text)])
    else:
        text = _C_COMMENT.sub(lambda found: found[1] or " ", text)
    return "\n".join(line.rstrip() for line in text.splitlines() if line.strip())


@cache
def _digest(path: Path) -> str:
    code = code_of(path.read_text(encoding="utf-8"), path.suffix)
    return hashlib.sha256(code.encode()).hexdigest()[:DIGITS]


_Place = tuple[int, int]
"""Line, from 1, and byte in it, from 0."""


def _comments(text: str) -> Iterator[tuple[_Place, _Place]]:
    if "#" not in text:
        return
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            start = len(token.line[:column].encode())
            yield (row, start), (row, start + len(token.string.encode()))


def _bare_strings(text: str) -> Iterator[tuple[_Place, _Place]]:
    for node in ast.walk(_parsed(text)):
        match node:
            case ast.Expr(value=ast.Constant(value=str())):
                yield (
                    (node.lineno, node.col_offset),
                    (node.end_lineno or node.lineno, node.end_col_offset or 0),
                )


def _without(text: str, spans: Iterable[tuple[_Place, _Place]]) -> str:
    lines = [line.encode() for line in text.splitlines()]
    for (first, start), (last, end) in sorted(spans, reverse=True):
        lines[first - 1 : last] = [lines[first - 1][:start] + lines[last - 1][end:]]
    return b"\n".join(lines).decode()


def _keeps_results(path: Path) -> bool:
    return path.parent == PACKAGE / "runs" and path.stem != "statistics"


def imported_modules(text: str, module: str = "") -> frozenset[str]:
    """Absolute names of all that a source may import; ``module`` resolves relative ones."""
    return frozenset(_imports(_parsed(text), module))


@cache
def _imported_by(path: Path) -> frozenset[str]:
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts)  # with ``__init__``: for one dot
    return imported_modules(path.read_text(encoding="utf-8"), name)


@cache
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


def _imports(tree: ast.AST, module: str) -> Iterator[str]:
    for node in ast.iter_child_nodes(tree):
        match node:
            case ast.If(test=ast.Name(id="TYPE_CHECKING")):  # never executed
                continue
            case ast.Import(names=names):
                yield from (alias.name for alias in names)
            case ast.ImportFrom(names=names, level=level):
                parent = ".".join(module.split(".")[:-level]) + "." if level else ""
                base = (parent + (node.module or "")).rstrip(".")
                yield base
                yield from (f"{base}.{alias.name}" for alias in names)
            case _:
                yield from _imports(node, module)


def _module_path(module: str) -> Path | None:
    parts = module.split(".")
    if parts[0] != PACKAGE.name:
        return None
    path = PACKAGE.joinpath(*parts[1:])
    if (path / "__init__.py").is_file():
        return path / "__init__.py"
    source = path.with_suffix(".py")
    return source if source.is_file() else None
