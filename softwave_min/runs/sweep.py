"""Carry a plan out: compute what is missing, tabulate, draw and judge it.

A sweep is a list of independent runs, of one experiment or of several. Each is written
as soon as it is done, so that an interrupted sweep resumes and loses at most the runs in
progress. Tables are made once the last of an experiment's runs is there, of the runs on
disk in their declared order, whoever computed them, and when.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
from tqdm import tqdm

from softwave_min.control.problem import Status
from softwave_min.parameters import ParameterSet
from softwave_min.runs.executor import (
    Executor,
    Outcome,
    Processes,
    attempt,
    completed,
    in_a_line,
    is_lost,
)
from softwave_min.runs.experiment import Experiment, Run
from softwave_min.runs.plan import Task
from softwave_min.runs.store import Store, machine, repository_state
from softwave_min.runs.tables import make_tables, publish

Draw = Callable[[Store, ParameterSet], None]
"""Draws an experiment's figures into its folder; runs in any process."""


class SweepError(RuntimeError):
    """Runs of a sweep failed."""


@dataclass(frozen=True)
class Swept:
    """An experiment of which no run is left to be computed."""

    task: Task
    computed: int
    """Runs computed, without those that are another's as well and were computed for it."""
    seconds: float
    """From the start of the first run to the end of the last."""
    failure: str = ""
    """Why there are no tables."""
    published: bool = False
    """Whether its tables were written where they are committed."""


@dataclass(frozen=True)
class Event:
    """Something that was done, or failed, in the course of a plan."""

    text: str
    failed: bool = False


def carry_out(
    plan: Sequence[Task], executor: Executor, draw: Draw, *, record: bool = False
) -> Iterator[Event]:
    """Compute, tabulate and draw what is missing or stale; say so as it is done.

    Figures are drawn while other experiments are computed. ``record``: the tables made here are
    to be committed, even where those that are agree with them.
    """
    several = len(plan) > 1 and executor.here
    painters = executor if several else Processes(1)
    drawn: list[tuple[Task, Future[None]]] = []
    for swept in compute_all(plan, executor, record=record):
        task, name = swept.task, swept.task.experiment.name
        if swept.failure:
            yield Event(swept.failure, failed=True)
            continue
        to_draw = swept.published or bool(task.figures)
        if swept.computed:
            yield Event(f"{name}: {swept.computed} runs computed in {swept.seconds:.1f} s")
        elif not to_draw:
            yield Event(f"{name}: up to date")
        if to_draw:
            drawn.append((task, painters.submit(draw, task.store, task.parameters)))
    for task, future in drawn:
        yield _drawn(task, future, draw)


def _drawn(task: Task, future: Future[None], draw: Draw) -> Event:
    name = task.experiment.name
    try:
        if is_lost(future):  # a run took its worker along
            draw(task.store, task.parameters)
        else:
            future.result()
    except Exception as error:
        return Event(f"{name}: the figures failed: {in_a_line(error)}", failed=True)
    return Event(f"{name}: figures drawn")


@dataclass
class _Share:
    """What an experiment has of a sweep."""

    task: Task
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
            self.task.store.save_run(run, outcome.arrays, _run_record(run, outcome))


Takers = list[tuple[_Share, Run]]
"""Those who want a run: it may have another name in each experiment."""


def compute(
    experiment: Experiment, parameters: ParameterSet, store: Store, executor: Executor
) -> int:
    """Compute the missing runs, then the tables; the number of runs computed.

    Raises
    ------
    SweepError
        If runs failed, after all others are done and saved, or their tables did.
    """
    (swept,) = compute_all([Task(experiment, parameters, store)], executor)
    if swept.failure:
        raise SweepError(swept.failure)
    return swept.computed


def compute_all(
    plan: Sequence[Task], executor: Executor, *, record: bool = False
) -> Iterator[Swept]:
    """Compute the missing runs of several experiments in one queue, each run once.

    Yields
    ------
    Swept
        Each experiment as soon as it has its tables, or all its runs and some of them failed.
    """
    aside = ThreadPoolExecutor(1)
    try:
        shares = [_share(task, aside if executor.here else None) for task in plan]
        yield from (_over(share, record) for share in shares if share.is_over)
        for touched in _taken(shares, executor):
            yield from (_over(share, record) for share in touched if share.is_over)
    finally:  # an error shall not wait for what nobody needs any more
        aside.shutdown(wait=False, cancel_futures=True)


def _taken(shares: Sequence[_Share], executor: Executor) -> Iterator[list[_Share]]:
    """Compute what is missing and give it to all who want it; those, after each run."""
    wanted: dict[str, Takers] = {}
    for share in shares:
        for run in share.missing:
            wanted.setdefault(run.identity, []).append((share, run))
    with _bar(shares) as bar:
        for takers, outcome in _outcomes(list(wanted.values()), executor):
            takers[0][0].count(outcome)
            for share, run in takers:
                share.take(run, outcome)
                bar.set_description(share.task.experiment.name, refresh=False)
            bar.set_postfix(failed=sum(len(one.failures) for one in shares), refresh=False)
            bar.update(len(takers))
            yield [share for share in shares if any(share is taker for taker, _ in takers)]


def _share(task: Task, aside: ThreadPoolExecutor | None) -> _Share:
    """Take over what experiments beside have, and have prepared ``aside`` what the rest needs."""
    missing = task.store.adopt(task.missing)
    share = _Share(task, missing)
    if aside and missing and task.experiment.prepare is not None:
        share.prepared = aside.submit(task.experiment.prepare, missing[0])
    return share


def _bar(shares: Sequence[_Share]) -> tqdm[NoReturn]:
    total, missing = (
        sum(len(runs) for runs in every)
        for every in ([one.task.runs for one in shares], [one.missing for one in shares])
    )
    return tqdm(
        total=total,
        initial=total - missing,
        unit="run",
        disable=not missing or not sys.stderr.isatty(),
    )


def _outcomes(wanted: Sequence[Takers], executor: Executor) -> Iterator[tuple[Takers, Outcome]]:
    """Compute what is wanted; first what need not wait for a preparation."""
    waits = [[share.prepared for share, _ in takers if share.prepared] for takers in wanted]
    at_once = [takers for takers, wait in zip(wanted, waits, strict=True) if not wait]
    then = [takers for takers, wait in zip(wanted, waits, strict=True) if wait]
    yield from _computed(at_once, executor)
    for wait in waits:
        for prepared in wait:
            prepared.result()
    yield from _computed(then, executor)


def _computed(wanted: Sequence[Takers], executor: Executor) -> Iterator[tuple[Takers, Outcome]]:
    runs = [takers[0][1] for takers in wanted]
    calls = [(run.compute, run.parameters, run.identity) for run in runs]
    for index, future in completed(executor, attempt, calls):
        try:
            outcome: Outcome = future.result()
        except Exception as error:  # of the worker, not of the run
            outcome = Outcome({}, 0.0, "", in_a_line(error))
        yield wanted[index], outcome


def _over(share: _Share, record: bool) -> Swept:
    """Make the tables, if no run failed, and publish them."""
    task, name = share.task, share.task.experiment.name
    now = time.perf_counter()
    seconds = now - min(now, share.started)
    task.store.tidy(task.runs)
    if share.failures:
        first = next(run.name for run in share.missing if run.name in share.failures)
        failure = (
            f"{name}: {len(share.failures)} of {len(task.runs)} runs failed, "
            f"the others are kept; first {first}: {share.failures[first]}"
        )
        return Swept(task, share.computed, seconds, failure)
    published = False
    try:
        if share.missing or task.made:
            make_tables(task, seconds if share.computed else None)
        if share.missing or task.made or task.tables or record:
            published = publish(task, record=record)
    except Exception as error:  # one experiment's failure must not stop the others
        failure = f"{name}: the tables failed, the runs are kept: {in_a_line(error)}"
        return Swept(task, share.computed, seconds, failure)
    return Swept(task, share.computed, seconds, published=published)


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
