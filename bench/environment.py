"""What the bench runs in: one processor, and for the peers an environment of their own."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from recording import Recording
from step_time import Sample

from softwave_min.data import ROOT
from softwave_min.native import compiler
from softwave_min.runs.store import machine, repository_state

__all__ = ["FORMULATIONS", "PeerMethod", "Peers", "circumstances", "on_one_core"]

Floats = NDArray[np.float64]

BENCH = Path(__file__).resolve().parent
PEERS = ROOT / ".build" / "bench-venv"
FORMULATIONS = {
    "collocation": "do-mpc, default collocation",
    "discrete": "do-mpc, the same discrete model",
}


def on_one_core() -> None:
    """Keep this process and its children on one processor and in one thread."""
    if os.environ.get("OMP_NUM_THREADS") != "1":
        again = subprocess.run(
            [sys.executable, *sys.argv], env={**os.environ, "OMP_NUM_THREADS": "1"}, check=False
        )
        sys.exit(again.returncode)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def peers_python() -> Path:
    """Interpreter of the peers' environment, which is made from bench.lock where it is not."""
    lock = BENCH / "bench.lock"
    stamp = PEERS / f"locked-{hashlib.sha256(lock.read_bytes()).hexdigest()[:16]}"
    python = PEERS / "bin" / "python"
    if not stamp.is_file():
        print("bench: installing bench.lock into .build/bench-venv", flush=True)
        install = ["install", "--quiet", "--require-hashes", "-r", lock]
        uv = shutil.which("uv")
        if uv:
            make = [uv, "venv", "--quiet", "--clear", "--python", sys.executable, PEERS]
            fill = [uv, "pip", *install, "--python", python]
        else:
            make = [sys.executable, "-m", "venv", "--clear", PEERS]
            fill = [python, "-m", "pip", *install]
        for command in (make, fill):
            subprocess.run(command, check=True)
        stamp.touch()
    return python


class Peers:
    """The process of ``peers.py``, which has the recordings and waits to be asked."""

    def __init__(self, recordings: Sequence[Recording], folder: Path) -> None:
        paths = [folder / f"{index}.npz" for index in range(len(recordings))]
        for path, recording in zip(paths, recordings, strict=True):
            recording.save(path)
        self._process = subprocess.Popen(
            [peers_python(), "-W", "ignore", BENCH / "peers.py", *paths],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.version: str = self._answer()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def ask(self, formulation: str, indices: range) -> list[Sample]:
        """Have these problems solved."""
        assert self._process.stdin is not None
        print(
            json.dumps([formulation, indices.start, indices.stop]),
            file=self._process.stdin,
            flush=True,
        )
        return [
            Sample(
                one["seconds"], one["iterations"], one["failed"], np.array(one["applied"]), np.nan
            )
            for one in self._answer()
        ]

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"peers.py ended with status {self._process.wait()}")
        return json.loads(line)


class PeerMethod:
    """One formulation of the peer as a method of the bench."""

    def __init__(self, peers: Peers, formulation: str, recordings: Sequence[Recording]) -> None:
        self.name = FORMULATIONS[formulation]
        self.expected: Floats = np.concatenate([recording.applied for recording in recordings])
        self.least: Floats = np.concatenate([recording.cost for recording in recordings])
        self._peers, self._formulation = peers, formulation

    def solve(self, indices: range) -> list[Sample]:
        """Solve the problems of these indices."""
        return self._peers.ask(self._formulation, indices)


def circumstances(load: float) -> dict[str, Any]:
    """Where and on what it is measured; ``load`` is the load average at the start."""
    here, source = machine(), repository_state()
    return {
        "processor": processor(),
        "cores": here["processors"],
        "platform": here["platform"],
        "compiler": compiler_version() or "none",
        "python": here["python"],
        **here["libraries"],
        "date": datetime.now(UTC).date().isoformat(),
        "load average at the start": round(load, 2),
        "commit": source["commit"] or "unknown",
        "commit is all": bool(source["clean"]),
    }


def processor() -> str:
    """Name of the processor, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if "model name" in line), "unknown")


def compiler_version() -> str | None:
    """First line of what the compiler says of itself."""
    command = compiler()
    if command is None:
        return None
    answer = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
    return answer.stdout.splitlines()[0]
