"""Compute what an experiment lacks, and judge what it has.

A sweep is a list of independent runs. Each is written as soon as it is done, so
that an interrupted sweep resumes and loses at most the runs in progress.
"""

from __future__ import annotations

import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from enum import Enum
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from softwave_min.control.nmpc import Status
from softwave_min.experiments import Experiment
from softwave_min.identity import digest, lock_digest, source_digest
from softwave_min.native import description
from softwave_min.parameters import ParameterSet
from softwave_min.store import Run, Store, machine, repository_state

__all__ = ["Freshness", "SweepError", "compute", "figures_identity", "freshness", "tables_identity"]


class SweepError(RuntimeError):
    """Runs of a sweep failed."""


class Freshness(Enum):
    """How results stand to what would be computed now."""

    FRESH = "fresh"
    """Computed here from the present inputs."""
    COMMITTED = "committed"
    """The tables are of the present inputs; the runs were computed elsewhere."""
    STALE = "stale"
    """Made from other inputs, or changed since."""
    MISSING = "missing"
    """Never computed."""


@dataclass(frozen=True)
class _Done:
    arrays: dict[str, NDArray[Any]]
    seconds: float


def tables_identity(experiment: Experiment, parameters: ParameterSet) -> str:
    """Hash over what determines an experiment's tables."""
    runs = experiment.runs(parameters)
    return digest(
        {run.name: run.identity for run in runs},
        source_digest(experiment.tabulate.__module__),
        lock_digest(),
    )


def figures_identity(experiment: Experiment, parameters: ParameterSet) -> str:
    """Hash over what determines an experiment's figures."""
    drawn_by = source_digest(f"softwave_min.figures.{experiment.name}")
    return digest(tables_identity(experiment, parameters), drawn_by)


def freshness(experiment: Experiment, parameters: ParameterSet, store: Store) -> Freshness:
    """Judge the tables and figures of an experiment."""
    record = store.provenance()
    if not record:
        return Freshness.MISSING
    if (
        record["tables_identity"] != tables_identity(experiment, parameters)
        or record.get("figures_identity") != figures_identity(experiment, parameters)
        or record["files"] != file_digests(store)
    ):
        return Freshness.STALE
    here = all(store.has(run) for run in experiment.runs(parameters))
    return Freshness.FRESH if here else Freshness.COMMITTED


def file_digests(store: Store) -> dict[str, str]:
    """SHA-256 of every committed file of an experiment, its provenance aside."""
    return {
        path.name: sha256(path.read_bytes()).hexdigest()
        for path in sorted(store.folder.iterdir())
        if path.is_file() and path.name != "provenance.json"
    }


def compute(experiment: Experiment, parameters: ParameterSet, store: Store, jobs: int) -> int:
    """Compute the missing runs, then the tables; the number of runs computed.

    Raises
    ------
    SweepError
        If runs failed, after all others are done and saved.
    """
    runs = experiment.runs(parameters)
    missing = [run for run in runs if not store.has(run)]
    started = time.perf_counter()
    failures: list[str] = []
    if missing:
        experiment.prepare(missing[0])
    for run, future in _computed(experiment.name, missing, jobs):
        try:
            done = future.result()
        except Exception as error:  # one failure must not stop the sweep
            failures.append(f"{run.name}: {error}")
        else:
            store.save_run(run, done.arrays, _run_record(run, done))
    if failures:
        raise SweepError(f"{experiment.name}: {len(failures)} failed; " + "; ".join(failures))
    if missing or store.provenance().get("tables_identity") != tables_identity(
        experiment, parameters
    ):
        _tabulate(experiment, parameters, store, runs, time.perf_counter() - started)
    return len(missing)


def _computed(name: str, runs: Sequence[Run], jobs: int) -> Iterator[tuple[Run, Future[_Done]]]:
    if not runs:
        return
    if min(jobs, len(runs)) == 1:
        for run in runs:
            future: Future[_Done] = Future()
            try:
                future.set_result(_timed(run))
            except Exception as error:  # the caller decides, as with other processes
                future.set_exception(error)
            yield run, future
        return
    # Fork would copy the libraries' threads in an unknown state.
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(min(jobs, len(runs)), mp_context=context) as pool,
        tqdm(total=len(runs), desc=name, unit="run", disable=not sys.stderr.isatty()) as bar,
    ):
        waiting = {pool.submit(_timed, run): run for run in runs}
        for future in as_completed(waiting):
            bar.update()
            yield waiting[future], future


def _timed(run: Run) -> _Done:
    started = time.perf_counter()
    arrays = {name: np.asarray(array) for name, array in run.compute(run.parameters).items()}
    return _Done(arrays, time.perf_counter() - started)


def _run_record(run: Run, done: _Done) -> dict[str, Any]:
    record: dict[str, Any] = {
        "identity": run.identity,
        "parameters": run.parameters,
        "seconds": round(done.seconds, 3),
        "engine": description(),
        "machine": machine(),
        **repository_state(),
    }
    statuses = [array for name, array in done.arrays.items() if name.endswith("status")]
    if statuses:
        values, counts = np.unique(np.concatenate(statuses), return_counts=True)
        record["solver_statuses"] = {
            Status(int(value)).name: int(count)
            for value, count in zip(values, counts, strict=True)
            if value >= 0
        }
    return record


def _tabulate(
    experiment: Experiment,
    parameters: ParameterSet,
    store: Store,
    runs: Sequence[Run],
    seconds: float,
) -> None:
    tables = experiment.tabulate(parameters, {run.name: store.load_run(run) for run in runs})
    for stem, table in tables.items():
        store.write_table(stem, table)
    of_runs = {run.name: store.run_record(run) for run in runs}
    store.write_provenance(
        {
            "experiment": experiment.name,
            "title": experiment.title,
            "claims": experiment.claims,
            "tables_identity": tables_identity(experiment, parameters),
            "lock": lock_digest(),
            "parameters": parameters,
            "runs": of_runs,
            "wall_time": round(seconds, 3),
            "machine": machine(),
            "files": file_digests(store),
            **repository_state(),
        }
    )
