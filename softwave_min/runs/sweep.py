"""Compute what experiments lack, and judge what they have.

A sweep is a list of independent runs, of one experiment or of several. Each is written
as soon as it is done, so that an interrupted sweep resumes and loses at most the runs in
progress. Tables are made once the last of an experiment's runs is there, of the runs on
disk in their declared order, whoever computed them, and when.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from enum import Enum
from hashlib import sha256
from typing import Any, NoReturn

import numpy as np
from tqdm import tqdm

from softwave_min.control.problem import Status
from softwave_min.native import description
from softwave_min.parameters import ParameterSet
from softwave_min.runs.executor import Outcome, Workers, attempt, in_a_line
from softwave_min.runs.experiment import Experiment, Run
from softwave_min.runs.identity import as_plain, digest, lock_digest, source_digest
from softwave_min.runs.store import Store, machine, repository_state


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
    return _tables_identity(experiment, experiment.runs(parameters))


def _tables_identity(experiment: Experiment, runs: Sequence[Run]) -> str:
    return digest(
        {run.name: run.identity for run in runs},
        source_digest(experiment.tabulate.__module__),
        lock_digest(),
    )


def figures_identity(experiment: Experiment, of_tables: str) -> str:
    """Hash over what determines an experiment's figures, that of its tables included."""
    return digest(of_tables, source_digest(f"softwave_min.figures.{experiment.name}"))


def freshness(experiment: Experiment, parameters: ParameterSet, store: Store) -> Freshness:
    """Judge the tables and figures of an experiment."""
    record = store.provenance()
    if not record:
        return Freshness.MISSING
    runs = experiment.runs(parameters)
    of_tables = _tables_identity(experiment, runs)
    if record["tables_identity"] != of_tables or not figures_are_current(
        store, figures_identity(experiment, of_tables)
    ):
        return Freshness.STALE
    here = all(store.has(run) for run in runs)
    return Freshness.FRESH if here else Freshness.COMMITTED


def figures_are_current(store: Store, identity: str) -> bool:
    """Whether the figures are those of an identity, and no file was changed since."""
    record = store.provenance()
    return record.get("figures_identity") == identity and record["files"] == file_digests(store)


def file_digests(store: Store) -> dict[str, str]:
    """SHA-256 of every committed file of an experiment, its provenance aside."""
    return {
        path.name: sha256(path.read_bytes()).hexdigest()
        for path in store.files()
        if path.name != "provenance.json"
    }


@dataclass(frozen=True)
class Swept:
    """An experiment of which no run is left to be computed."""

    experiment: Experiment
    identity: str
    """Of its tables."""
    computed: int
    """Runs computed, without those that are another's as well and were computed for it."""
    seconds: float
    """From the start of the first run to the end of the last."""
    failure: str = ""
    """Why there are no tables."""


@dataclass
class _Share:
    """What an experiment has of a sweep."""

    experiment: Experiment
    store: Store
    runs: Sequence[Run]
    missing: Sequence[Run]
    prepared: Future[object] | None = None
    """To be waited for before its runs are computed."""
    failures: dict[str, str] = field(default_factory=dict)
    """Why there is no result, by the run's name."""
    arrived: int = 0
    computed: int = 0
    started: float = math.inf

    @property
    def is_over(self) -> bool:
        return self.arrived == len(self.missing)

    def count(self, outcome: Outcome) -> None:
        """Count a run that was computed for this experiment."""
        self.computed += 1
        self.started = min(self.started, time.perf_counter() - outcome.seconds)

    def take(self, run: Run, outcome: Outcome) -> None:
        """Save a run, or note why there is none."""
        self.arrived += 1
        if outcome.failure:
            self.failures[run.name] = outcome.failure
        else:
            self.store.save_run(run, outcome.arrays, _run_record(run, outcome))


Takers = list[tuple[_Share, Run]]
"""Those who want a run: it may have another name in each experiment."""


def compute(
    experiment: Experiment, parameters: ParameterSet, store: Store, workers: Workers
) -> int:
    """Compute the missing runs, then the tables; the number of runs computed.

    Raises
    ------
    SweepError
        If runs failed, after all others are done and saved.
    """
    (swept,) = compute_all([(experiment, store)], parameters, workers)
    if swept.failure:
        raise SweepError(swept.failure)
    return swept.computed


def compute_all(
    asked: Sequence[tuple[Experiment, Store]], parameters: ParameterSet, workers: Workers
) -> Iterator[Swept]:
    """Compute the missing runs of several experiments in one queue, each run once.

    Yields
    ------
    Swept
        Each experiment as soon as it has its tables, or all its runs and some of them failed.
    """
    aside = ThreadPoolExecutor(1)
    try:
        shares = [_share(*one, parameters, aside if workers.here else None) for one in asked]
        yield from (_over(share, parameters) for share in shares if share.is_over)
        for touched in _taken(shares, workers):
            yield from (_over(share, parameters) for share in touched if share.is_over)
    finally:  # an error shall not wait for what nobody needs any more
        aside.shutdown(wait=False, cancel_futures=True)


def _taken(shares: Sequence[_Share], workers: Workers) -> Iterator[list[_Share]]:
    """Compute what is missing and give it to all who want it; those, after each run."""
    wanted: dict[str, Takers] = {}
    for share in shares:
        for run in share.missing:
            wanted.setdefault(run.identity, []).append((share, run))
    with _bar(shares) as bar:
        for takers, outcome in _outcomes(list(wanted.values()), workers):
            takers[0][0].count(outcome)
            for share, run in takers:
                share.take(run, outcome)
                bar.set_description(share.experiment.name, refresh=False)
            bar.set_postfix(failed=sum(len(one.failures) for one in shares), refresh=False)
            bar.update(len(takers))
            yield [share for share in shares if any(share is taker for taker, _ in takers)]


def _share(
    experiment: Experiment,
    store: Store,
    parameters: ParameterSet,
    aside: ThreadPoolExecutor | None,
) -> _Share:
    """Look for what is missing, and have prepared ``aside`` what that needs."""
    runs = experiment.runs(parameters)
    missing = store.adopt([run for run in runs if not store.has(run)])
    share = _Share(experiment, store, runs, missing)
    if aside and missing and experiment.prepare is not None:
        share.prepared = aside.submit(experiment.prepare, missing[0])
    return share


def _bar(shares: Sequence[_Share]) -> tqdm[NoReturn]:
    total, missing = (
        sum(len(runs) for runs in every)
        for every in ([one.runs for one in shares], [one.missing for one in shares])
    )
    return tqdm(
        total=total,
        initial=total - missing,
        unit="run",
        disable=not missing or not sys.stderr.isatty(),
    )


def _outcomes(wanted: Sequence[Takers], workers: Workers) -> Iterator[tuple[Takers, Outcome]]:
    """Compute what is wanted; first what need not wait for a preparation."""
    waits = [[share.prepared for share, _ in takers if share.prepared] for takers in wanted]
    at_once = [takers for takers, wait in zip(wanted, waits, strict=True) if not wait]
    then = [takers for takers, wait in zip(wanted, waits, strict=True) if wait]
    yield from _computed(at_once, workers)
    for wait in waits:
        for prepared in wait:
            prepared.result()
    yield from _computed(then, workers)


def _computed(wanted: Sequence[Takers], workers: Workers) -> Iterator[tuple[Takers, Outcome]]:
    if not wanted:  # nor is a cluster, which may be gone by now
        return
    runs = [takers[0][1] for takers in wanted]
    calls = [(run.compute, run.parameters, run.identity) for run in runs]
    for index, result in workers.completed(attempt, calls):
        try:
            outcome: Outcome = result.result()
        except Exception as error:  # of the worker, not of the run
            outcome = Outcome({}, 0.0, "", in_a_line(error))
        yield wanted[index], outcome


def _over(share: _Share, parameters: ParameterSet) -> Swept:
    """Make the tables, if no run failed."""
    now = time.perf_counter()
    swept = Swept(
        share.experiment,
        _tables_identity(share.experiment, share.runs),
        share.computed,
        now - min(now, share.started),
    )
    share.store.tidy(share.runs)
    if share.failures:
        first = next(run.name for run in share.missing if run.name in share.failures)
        failure = (
            f"{share.experiment.name}: {len(share.failures)} of {len(share.runs)} runs failed, "
            f"the others are kept; first {first}: {share.failures[first]}"
        )
        return replace(swept, failure=failure)
    if share.missing or not _tables_are_current(share.store, swept.identity):
        _tabulate(swept, parameters, share.store, share.runs)
    return swept


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


def _tables_are_current(store: Store, identity: str) -> bool:
    record = store.provenance()
    if record.get("tables_identity") != identity:
        return False
    found = file_digests(store)
    return all(
        found.get(name) == content
        for name, content in record["files"].items()
        if name.endswith(".csv")
    )


def _tabulate(swept: Swept, parameters: ParameterSet, store: Store, runs: Sequence[Run]) -> None:
    experiment = swept.experiment
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
            "tables_identity": swept.identity,
            "lock": lock_digest(),
            "runs": of_runs,
            # Where no run was computed for this experiment, no time was either.
            **({"wall_time": round(swept.seconds, 3)} if swept.computed else {}),
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
