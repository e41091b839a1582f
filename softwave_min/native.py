"""Compile C to a shared library once, and keep it.

A library is cached by the content of its sources, the compiler with its version, the
flags and the processor, so that it is never stale; it appears under its name only
when it is whole. Of several processes that want it one compiles, and the others wait.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

from softwave_min.data import cache_folder

FLAGS = ("-march=native", "-fno-math-errno", "-ffp-contract=fast", "-std=c99", "-fPIC")
"""No -ffast-math: the interpreter's numbers, but for the last digit of a product and sum."""
LOOPS, STRAIGHT_LINE = ("-O3", "-funroll-loops"), ("-O2",)
"""Generated code only takes longer with more than -O2."""
MANY_LINES = 1000
"""So many lines are generated, not written."""


class CompilerError(RuntimeError):
    """A compiler is there and failed."""


@cache
def compiler() -> tuple[str, ...] | None:
    """Command of a C compiler: CC, else cc, gcc or clang, else the package ziglang.

    SOFTWAVE_COMPILER=none says to do without; any other value names the command.
    """
    asked = os.environ.get("SOFTWAVE_COMPILER") or os.environ.get("CC")
    if asked == "none":
        return None
    for candidate in (asked, "cc", "gcc", "clang"):
        found = shutil.which(candidate) if candidate else None
        if found:
            return (found,)
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc")
    return None


def description() -> str:
    """Which of the two paths runs, in a word or two."""
    command = compiler()
    if command is None:
        return "interpreted"
    return f"compiled by {'ziglang' if len(command) > 1 else Path(command[0]).name}"


def build(name: str, sources: Mapping[str, str]) -> Path:
    """Shared library made of the sources, by file name.

    Raises
    ------
    CompilerError
        If there is no compiler, or it fails; with the first line that it prints.
    """
    command = compiler()
    if command is None:
        raise CompilerError("no C compiler")
    library = cache_folder() / "native" / f"{name}-{_key(command, sources)}.so"
    if library.is_file():
        return library
    library.parent.mkdir(parents=True, exist_ok=True)
    with open(library.with_suffix(".lock"), "w", encoding="utf-8") as alone:
        with contextlib.suppress(ImportError, OSError):  # no such locks: several compile the same
            import fcntl  # noqa: PLC0415 - not on every system

            fcntl.flock(alone, fcntl.LOCK_EX)
        if not library.is_file():
            _compile(command, library, sources)
    return library


def _compile(command: tuple[str, ...], library: Path, sources: Mapping[str, str]) -> None:
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        for file_name, text in sources.items():
            (Path(folder) / file_name).write_text(text, encoding="utf-8")
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            compiled = [
                pool.submit(_run, [*command, *_flags(text), "-c", file_name], folder)
                for file_name, text in sources.items()
            ]
        for one in compiled:
            one.result()
        objects = [Path(file_name).stem + ".o" for file_name in sorted(sources)]
        _run([*command, "-shared", *objects, "-o", library.name, "-lm"], folder)
        os.replace(Path(folder) / library.name, library)


def _flags(text: str) -> tuple[str, ...]:
    return (*FLAGS, *(STRAIGHT_LINE if text.count("\n") > MANY_LINES else LOOPS))


def _run(command: list[str], folder: str) -> None:
    answer = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if answer.returncode:
        message = (answer.stderr.strip() or "no message").splitlines()[0]
        raise CompilerError(f"{command[0]}: {message}")


def _key(command: tuple[str, ...], sources: Mapping[str, str]) -> str:
    version = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    parts = [*command, version.stdout, platform.machine(), _processor()]
    for name in sorted(sources):
        parts += [name, *_flags(sources[name]), sources[name]]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _processor() -> str:
    """Model and features of the processor, which -march=native depends on."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags"))}))
