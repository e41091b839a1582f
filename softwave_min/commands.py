"""The commands: what each prints, and its exit status.

What only some of them need is imported there: most often they find that nothing is to be done.
"""
# ruff: noqa: PLC0415

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TextIO

from tqdm import tqdm

from softwave_min.data import ParameterError, data_folder
from softwave_min.figures.files import draw_files
from softwave_min.native import description
from softwave_min.parameters import (
    DEFAULT_SET,
    SET_NAMES,
    ParameterSet,
    load_parameters,
    parameter_set,
)
from softwave_min.runs.compare import (
    Comparison,
    committed_stems,
    committed_text,
    compare_texts,
    require_commit,
    tolerances_of,
)
from softwave_min.runs.executor import Cluster, Executor, Processes
from softwave_min.runs.experiment import Experiment
from softwave_min.runs.plan import Freshness, Task
from softwave_min.runs.store import Store, results_folder, table_text, write_atomically
from softwave_min.studies.catalogue import NAMES, experiment

SEARCH = "calibration"
"""Folder of its results."""


@dataclass(frozen=True)
class _Asked:
    """What a command line asks for."""

    names: tuple[str, ...]
    """Of experiments."""
    by_name: bool
    parameters: ParameterSet
    place: Path
    """Where the parameters' results lie below ``results/``."""
    root: Path
    """The folder that stands for it."""

    def task(self, one: Experiment) -> Task:
        return Task(one, self.parameters, Store(one.name, self.root))

    def tasks(self, experiments: Sequence[Experiment]) -> tuple[list[Task], bool]:
        """What there is to do, and whether the parameters rule some of it out; says what."""
        tasks = [self.task(one) for one in experiments]
        for task in tasks:
            if task.refusal:
                print(f"{task.experiment.name}: {task.refusal}", file=sys.stderr)
        possible = [task for task in tasks if not task.refusal]
        return possible, len(possible) < len(tasks)

    @property
    def experiments(self) -> tuple[Experiment, ...]:
        return tuple(experiment(name) for name in self.names)

    @property
    def not_waited_for(self) -> tuple[Experiment, ...]:
        """Those that nobody named and that take too long to be computed unasked."""
        return () if self.by_name else tuple(one for one in self.experiments if one.on_request)

    @property
    def computed(self) -> tuple[Experiment, ...]:
        left = self.not_waited_for
        return tuple(one for one in self.experiments if one not in left)


def _asked(options: Namespace) -> _Asked:
    parameters, label = _parameters(options.set or DEFAULT_SET, options.parameters)
    if options.seeds not in {None, parameters.sea.realisations}:
        parameters = replace(parameters, sea=replace(parameters.sea, realisations=options.seeds))
        label = f"{label}-{options.seeds}-seeds"
    place = Path() if label == DEFAULT_SET else Path("sets", label)
    names = getattr(options, "names", [])
    for name in names:
        if name not in NAMES:
            raise ParameterError(f"no experiment {name!r}; there are: {', '.join(NAMES)}")
    return _Asked(
        names=tuple(names or NAMES),
        by_name=bool(names),
        parameters=parameters,
        place=place,
        root=options.results.resolve() if options.results else results_folder() / place,
    )


def _parameters(name: str, file: Path | None) -> tuple[ParameterSet, str]:
    """The set, and what its results are labelled with."""
    if file is None:
        return parameter_set(name), name
    parameters = load_parameters(file)
    if file.stem in SET_NAMES and file.resolve().parent != data_folder() / "parameters":
        raise ParameterError(f"{file}: a set that ships has that name; call it otherwise")
    return parameters, file.stem


def _executor(options: Namespace) -> Executor:
    return (
        Cluster(options.scheduler)
        if options.scheduler
        else Processes(options.jobs or os.cpu_count() or 1)
    )


# --- list -------------------------------------------------------------------------------


def list_experiments(options: Namespace) -> int:
    """Name, number of runs, claims and title of each experiment."""
    asked = _asked(options)
    tasks, refused = asked.tasks(asked.experiments)
    for task in tasks:
        one, runs = task.experiment, len(task.runs)
        request = "on request" if one.on_request else ""
        print(f"{one.name:18} {runs:5} runs {request:11} {_claims(one.claims):10} {one.title}")
    return int(refused)


def _claims(ids: Sequence[str]) -> str:
    """'C01-C03, C07' from single ids; those of one letter that follow one another are joined."""
    numbered = [(int(one[1:]) - place, one) for place, one in enumerate(sorted(ids))]
    groups = [[one for _, one in group] for _, group in groupby(numbered, key=lambda item: item[0])]
    return ", ".join(group[0] if len(group) == 1 else f"{group[0]}-{group[-1]}" for group in groups)


# --- run --------------------------------------------------------------------------------


def run(options: Namespace) -> int:
    """Compute what is missing or stale, and draw its figures."""
    from softwave_min.paper.claims import missing_tables
    from softwave_min.runs.sweep import carry_out

    asked = _asked(options)
    plan, failed = asked.tasks(asked.computed)
    if options.dry_run:
        for task in plan:
            print(task)
        return int(failed)
    with _executor(options) as executor:
        _announce(options)
        for event in carry_out(plan, executor, draw_files, record=options.record):
            failed |= event.failed
            _say(event.text, sys.stderr if event.failed else sys.stdout)
    for one in asked.not_waited_for:
        task = asked.task(one)
        if not task.refusal and task.freshness is Freshness.STALE:
            print(f"{one.name}: stale; computed on request only: 'run {one.name}'")
    if not failed and not missing_tables(asked.root):
        _judge(asked)
    return int(failed)


def _announce(options: Namespace) -> None:
    where = f"on the cluster at {options.scheduler}" if options.scheduler else description()
    print(f"controllers and plant: {where}", flush=True)


def _say(text: str, stream: TextIO) -> None:
    """Print a line beside the progress bar, if there is one."""
    with tqdm.external_write_mode():
        print(text, file=stream, flush=True)


def _judge(asked: _Asked) -> None:
    """Judge the claims, and write that unless it is what was written."""
    from softwave_min.paper.verdicts import evaluate, verdicts_path, write

    table, path = evaluate(asked.root, asked.parameters), verdicts_path(asked.root)
    if not path.is_file() or path.read_text(encoding="utf-8") != table_text(table):
        write(table, asked.root)
        print("claims: judged", flush=True)


# --- what is there ----------------------------------------------------------------------


def figures(options: Namespace) -> int:
    """Draw every figure anew from the runs that are here."""
    asked = _asked(options)
    tasks, refused = asked.tasks(asked.experiments)
    for task in tasks:
        name, found = task.experiment.name, task.freshness
        if task.experiment in asked.not_waited_for and found in {
            Freshness.MISSING,
            Freshness.COMMITTED,
        }:
            continue
        if found is Freshness.MISSING:
            raise ParameterError(f"{name}: nothing to draw; 'run {name}' computes it")
        draw_files(task.store, asked.parameters)
        print(f"{name}: figures drawn", flush=True)
    return int(refused)


def status(options: Namespace) -> int:
    """Say what is fresh and what is stale."""
    from softwave_min.paper.verdicts import are_fresh, verdicts_path

    asked = _asked(options)
    stale = []
    tasks, refused = asked.tasks(asked.experiments)
    for task in tasks:
        found = task.freshness
        print(f"{task.experiment.name}: {found.value}")
        stale += [task] * (found is Freshness.STALE)
    if stale:
        named = " ".join(task.experiment.name for task in stale if task.experiment.on_request)
        remedy = "run 'make all'" + f", and 'run {named}' of this command" * bool(named)
        print(f"{len(stale)} of the results are stale: {remedy}", file=sys.stderr)
    elif verdicts_path(asked.root).is_file() and not are_fresh(asked.root, asked.parameters):
        print("claims: stale")
        print("the verdicts are not those of the tables: run 'claims'", file=sys.stderr)
        return 1
    return int(refused or bool(stale))


def claims(options: Namespace) -> int:
    """Judge the paper's claims by the tables that are here."""
    from softwave_min.paper.verdicts import evaluate, summary, unexplained, write

    asked = _asked(options)
    table = evaluate(asked.root, asked.parameters)
    path = write(table, asked.root)
    print(summary(table))
    print(path)
    if bare := unexplained(table):
        print(f"claims without a reason for their verdict: {', '.join(bare)}", file=sys.stderr)
    return 0


def compare(options: Namespace) -> int:
    """Compare the tables with the committed ones: those that were made here, if any were."""
    asked = _asked(options)
    if options.strict:
        require_commit()
    differ = 0
    for name in asked.names:
        store = Store(name, asked.root).latest()
        differ += _compared(name, store.stems(), store, asked.place)
    return 1 if options.strict and differ else 0


# --- calibration ------------------------------------------------------------------------


def calibrate(options: Namespace) -> int:
    """Search for the parameter set that comes closest to the paper's numbers."""
    from softwave_min.studies.calibration import best_of, best_set_text, search_settings
    from softwave_min.studies.calibration import calibrate as search_for_set

    store = Store(SEARCH, options.results.resolve() if options.results else results_folder())
    with _executor(options) as executor:
        _announce(options)
        table = search_for_set(store, executor, search_settings())
    best = best_of(table)
    print(f"{len(table)} sets judged; objective {table['objective'][0]:.2f} at the start, ", end="")
    print(f"{best['objective']:.2f} at the best")
    if options.write:
        folder = data_folder() / "parameters"
        write_atomically(folder / f"{DEFAULT_SET}.toml", best_set_text(table, folder).encode())
        print(f"data/parameters/{DEFAULT_SET}.toml written")
    return 0


# --- sensitivity ------------------------------------------------------------------------


def sensitivity(options: Namespace) -> int:
    """Find out which of the open parameters decide the headline numbers."""
    from softwave_min.studies.sensitivity import NAME, investigate, study_settings

    store = Store(NAME, options.results.resolve() if options.results else results_folder())
    with _executor(options) as executor:
        _announce(options)
        important = investigate(store, executor, study_settings())
    print(f"the values that matter most: {', '.join(important)}")
    return 0


# --- verify -----------------------------------------------------------------------------


def verify(options: Namespace) -> int:
    """Compute anew in a folder of its own, and compare with the committed tables."""
    from softwave_min.runs.sweep import SweepError, compute_all

    asked = _asked(options)
    committed = {one.name: committed_stems(asked.place / one.name) for one in asked.computed}
    chosen = [one for one in asked.computed if committed[one.name]]
    for one in asked.computed if asked.by_name else ():
        if one not in chosen:
            raise ParameterError(f"{one.name}: no tables are committed to compare with")
    if not chosen:
        raise ParameterError("no tables are committed to compare with")
    differ = 0
    with TemporaryDirectory(prefix="softwave-verify-") as folder, _executor(options) as executor:
        _announce(options)
        plan, refused = replace(asked, root=Path(folder)).tasks(chosen)
        for swept in compute_all(plan, executor):
            if swept.failure:
                raise SweepError(swept.failure)
            one, store = swept.task.experiment, swept.task.store
            stems = sorted({*committed[one.name], *store.stems()})
            differ += _compared(one.name, stems, store, asked.place)
    if differ:
        print(f"{differ} of the tables differ from the committed ones", file=sys.stderr)
    return int(refused or differ > 0)


def _compared(name: str, stems: Sequence[str], store: Store, place: Path) -> int:
    """Compare an experiment's tables and say what came of it; how many differ."""
    differ = 0
    for stem in stems:
        outcome = Comparison(agrees=False, text="DIFFERS: committed, and not made any more")
        if stem in store.stems():
            ours, committed = store.table_text(stem), committed_text(place / name, stem)
            allowed = {} if ours == committed else tolerances_of(experiment(name).tolerances, stem)
            outcome = compare_texts(ours, committed, allowed)
        _say(f"{name}/{stem}.csv: {outcome.text}", sys.stdout)
        for difference in outcome.differences:
            _say(f"  {difference}", sys.stdout)
        differ += not outcome.agrees
    return differ
