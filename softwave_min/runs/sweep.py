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
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
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
from softwave_min.runs.store import Store, machine, repository_state, tidy_runs
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
    missing: Mapping[str, Path]
    """The file of each run that is not here, by the run's name."""
    left: set[Path]
    """Those that are still to be computed."""
    failures: dict[Path, str] = field(default_factory=dict)
    """Why there is none."""
    computed: int = 0
    started: float = math.inf


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
    runs = {task.store.run_path(run): (task.store, run) for task in plan for run in task.missing}
    shares = []
    for task in plan:
        missing = {run.name: task.store.run_path(run) for run in task.missing}
        shares.append(_Share(task, missing, set(missing.values())))
    for root in {task.store.root for task in plan}:  # after those that are wanted were asked for
        tidy_runs(root)
    yield from (_over(share, record) for share in shares if not share.missing)
    with _bar(shares) as bar:
        for path, outcome in _computed({path: run for path, (_, run) in runs.items()}, executor):
            if not outcome.failure:
                store, run = runs[path]
                store.save_run(run, outcome.arrays, _run_record(run, outcome))
            takers = [share for share in shares if path in share.left]
            _count(takers, path, outcome)
            bar.set_description(takers[0].task.experiment.name, refresh=False)
            bar.set_postfix(failed=sum(len(one.failures) for one in shares), refresh=False)
            bar.update()
            yield from (_over(share, record) for share in takers if not share.left)


def _count(takers: Sequence[_Share], path: Path, outcome: Outcome) -> None:
    """Tell all who want a run what came of it; it was computed for the first of them."""
    for share in takers:
        share.left.remove(path)
        if outcome.failure:
            share.failures[path] = outcome.failure
    takers[0].computed += 1
    takers[0].started = min(takers[0].started, time.perf_counter() - outcome.seconds)


def _bar(shares: Sequence[_Share]) -> tqdm[NoReturn]:
    paths = {share.task.store.run_path(run) for share in shares for run in share.task.runs}
    missing = set().union(*(share.left for share in shares))
    return tqdm(
        total=len(paths),
        initial=len(paths) - len(missing),
        unit="run",
        disable=not missing or not sys.stderr.isatty(),
    )


def _computed(wanted: Mapping[Path, Run], executor: Executor) -> Iterator[tuple[Path, Outcome]]:
    paths = list(wanted)
    calls = [(run.compute, run.parameters, run.identity) for run in wanted.values()]
    for index, future in completed(executor, attempt, calls):
        try:
            outcome: Outcome = future.result()
        except Exception as error:  # of the worker, not of the run
            outcome = Outcome({}, 0.0, "", in_a_line(error))
        yield paths[index], outcome


def _over(share: _Share, record: bool) -> Swept:
    """Make the tables, if no run failed, and publish them."""
    task, name = share.task, share.task.experiment.name
    now = time.perf_counter()
    seconds = now - min(now, share.started)
    task.store.tidy()
    if share.failures:
        failed = [run for run, path in share.missing.items() if path in share.failures]
        failure = (
            f"{name}: {len(failed)} of {len(task.runs)} runs failed, the others are kept; "
            f"first {failed[0]}: {share.failures[share.missing[failed[0]]]}"
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
