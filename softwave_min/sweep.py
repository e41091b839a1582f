"""Compute what an experiment lacks, and judge what it has.

A sweep is a list of independent runs. Each is written as soon as it is done, so
that an interrupted sweep resumes and loses at most the runs in progress. Tables are
made of the runs on disk in their declared order, whoever computed them, and when.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from concurrent.futures import Future
from enum import Enum
from hashlib import sha256
from typing import Any

import numpy as np
from tqdm import tqdm

from softwave_min.control.nmpc import Status
from softwave_min.experiments import Experiment
from softwave_min.identity import as_plain, digest, lock_digest, source_digest
from softwave_min.native import description
from softwave_min.parameters import ParameterSet
from softwave_min.store import Run, Store, machine, repository_state
from softwave_min.workers import Outcome, Workers, attempt, in_a_line

__all__ = [
    "Freshness",
    "SweepError",
    "compute",
    "figures_are_current",
    "figures_identity",
    "file_digests",
    "freshness",
    "prepare",
    "tables_identity",
]


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
    if record["tables_identity"] != tables_identity(
        experiment, parameters
    ) or not figures_are_current(experiment, parameters, store):
        return Freshness.STALE
    here = all(store.has(run) for run in experiment.runs(parameters))
    return Freshness.FRESH if here else Freshness.COMMITTED


def figures_are_current(experiment: Experiment, parameters: ParameterSet, store: Store) -> bool:
    """Whether the figures are of the present inputs, and no file was changed since."""
    record = store.provenance()
    return record.get("figures_identity") == figures_identity(experiment, parameters) and record[
        "files"
    ] == file_digests(store)


def file_digests(store: Store) -> dict[str, str]:
    """SHA-256 of every committed file of an experiment, its provenance aside."""
    return {
        path.name: sha256(path.read_bytes()).hexdigest()
        for path in store.files()
        if path.name != "provenance.json"
    }


def prepare(experiment: Experiment, parameters: ParameterSet, store: Store) -> None:
    """Compile what the missing runs need."""
    if experiment.prepare is None:
        return
    for run in experiment.runs(parameters):
        if not store.has(run):
            experiment.prepare(run)
            return


def compute(
    experiment: Experiment,
    parameters: ParameterSet,
    store: Store,
    workers: Workers,
    prepared: Future[None] | None = None,
) -> int:
    """Compute the missing runs, then the tables; the number of runs computed.

    ``prepared`` is waited for where runs are to be prepared; without it that is done here.

    Raises
    ------
    SweepError
        If runs failed, after all others are done and saved.
    """
    runs = experiment.runs(parameters)
    missing = store.adopt([run for run in runs if not store.has(run)])
    started = time.perf_counter()
    failures = []
    if missing:
        if experiment.prepare is not None and workers.here:
            prepared.result() if prepared else experiment.prepare(missing[0])
        failures = _compute_runs(experiment, missing, len(runs), store, workers)
    store.tidy(runs)
    if failures:
        raise SweepError(
            f"{experiment.name}: {len(failures)} of {len(runs)} runs failed, "
            f"the others are kept; first {failures[0]}"
        )
    if missing or not _tables_are_current(experiment, parameters, store):
        _tabulate(experiment, parameters, store, runs, time.perf_counter() - started)
    return len(missing)


def _compute_runs(
    experiment: Experiment, missing: Sequence[Run], total: int, store: Store, workers: Workers
) -> list[str]:
    """Compute runs and save each as it is done; the failures."""
    failures: list[str] = []
    calls = [(run.compute, run.parameters, run.identity) for run in missing]
    with tqdm(
        desc=experiment.name,
        total=total,
        initial=total - len(missing),
        unit="run",
        disable=not sys.stderr.isatty(),
    ) as bar:
        bar.set_postfix(failed=0)
        for index, result in workers.completed(attempt, calls):
            run = missing[index]
            try:
                outcome: Outcome = result.result()
                failure = outcome.failure
            except Exception as error:  # of the worker, not of the run
                failure = in_a_line(error)
            if failure:
                failures.append(f"{run.name}: {failure}")
                bar.set_postfix(failed=len(failures))
            else:
                store.save_run(run, outcome.arrays, _run_record(run, outcome))
            bar.update()
    return failures


def _run_record(run: Run, outcome: Outcome) -> dict[str, Any]:
    record: dict[str, Any] = {
        "identity": run.identity,
        "parameters": run.parameters,
        "seconds": round(outcome.seconds, 3),
        "engine": outcome.engine,
        "machine": machine(),
        **repository_state(),
    }
    statuses = [array for name, array in outcome.arrays.items() if name.endswith("status")]
    if statuses:
        values, counts = np.unique(np.concatenate(statuses), return_counts=True)
        record["solver_statuses"] = {
            Status(int(value)).name: int(count)
            for value, count in zip(values, counts, strict=True)
            if value >= 0
        }
    return record


def _tables_are_current(experiment: Experiment, parameters: ParameterSet, store: Store) -> bool:
    record = store.provenance()
    if record.get("tables_identity") != tables_identity(experiment, parameters):
        return False
    found = file_digests(store)
    return all(
        found.get(name) == content
        for name, content in record["files"].items()
        if name.endswith(".csv")
    )


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
    common = {
        "engine": description(),
        "machine": machine(),
        "parameters": as_plain(parameters),
        **repository_state(),
    }
    of_runs = {run.name: _in_particular(store.run_record(run), common) for run in runs}
    store.write_provenance(
        {
            "experiment": experiment.name,
            "title": experiment.title,
            "claims": experiment.claims,
            "tables_identity": tables_identity(experiment, parameters),
            "lock": lock_digest(),
            "runs": of_runs,
            "wall_time": round(seconds, 3),
            "files": file_digests(store),
            **common,
        }
    )


def _in_particular(record: dict[str, Any], common: dict[str, Any]) -> dict[str, Any]:
    """A run's record without what the experiment's says of all runs.

    A parameter set in it is reduced to what differs from the experiment's.
    """
    own = {key: value for key, value in record.items() if common.get(key) != value}
    if "parameters" in own:
        own["parameters"] = _reduced(own["parameters"], common["parameters"])
    return own


def _reduced(tree: Any, common: dict[str, Any]) -> Any:
    if not isinstance(tree, dict):
        return tree
    if tree.keys() == common.keys():
        return _changes(tree, common)
    return {key: _reduced(value, common) for key, value in tree.items()}


def _changes(tree: dict[str, Any], common: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _changes(value, common[key]) if isinstance(value, dict) else value
        for key, value in tree.items()
        if value != common[key]
    }
