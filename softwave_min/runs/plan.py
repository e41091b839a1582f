"""What is to be done for the results of experiments, and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

from softwave_min.data import ParameterError
from softwave_min.parameters import ParameterSet
from softwave_min.runs.experiment import Experiment, Run
from softwave_min.runs.identity import (
    NUMERICAL,
    Identity,
    digest,
    locked,
    modules_of_run,
    named_digests,
)
from softwave_min.runs.source import imported_libraries, source_digests
from softwave_min.runs.store import Store


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
class Task:
    """What there is to do for the results of one experiment."""

    experiment: Experiment
    parameters: ParameterSet
    store: Store

    @cached_property
    def runs(self) -> Sequence[Run]:
        """All runs."""
        return self.experiment.runs(self.parameters)

    @cached_property
    def refusal(self) -> str:
        """Why the experiment cannot be run with the parameters; empty if it can."""
        try:
            _ = self.runs
        except ParameterError as error:
            return str(error)
        return ""

    @cached_property
    def missing(self) -> list[Run]:
        """Runs that are not here."""
        return [run for run in self.runs if not self.store.has(run)]

    @cached_property
    def made(self) -> list[str]:
        """Why the tables made here are not those of the present inputs; empty if they are."""
        return self._changes_of_tables(self.store.made)

    @cached_property
    def tables(self) -> list[str]:
        """Why the tables that are to be committed are not those of the present inputs."""
        return self._changes_of_tables(self.store)

    @cached_property
    def figures(self) -> list[str]:
        """Why the figures are not those of the present tables and code."""
        if self.tables:
            return ["tables"]
        record = self.store.provenance()
        recorded = _recorded(record, "figures")
        now = figures_identity(
            self.experiment.name,
            Identity(_recorded(record, "tables")).digest,
            _read(recorded),
            self.store.root,
        )
        return [*now.changes(recorded), *_changed_files(self.store, record, "")]

    @property
    def is_done(self) -> bool:
        """Whether there is nothing to do."""
        return not (self.missing or self.made or self.tables or self.figures)

    @property
    def freshness(self) -> Freshness:
        """Judge what is there."""
        if not self.store.provenance():
            return Freshness.MISSING
        if self.tables or self.figures:
            return Freshness.STALE
        return Freshness.COMMITTED if self.made or self.missing else Freshness.FRESH

    def __str__(self) -> str:
        if self.is_done:
            return f"{self.experiment.name}: up to date"
        steps = [f"compute {len(self.missing)} of {len(self.runs)} runs"] if self.missing else []
        if self.tables:
            steps.append(f"tables: {', '.join(self.tables)}")
        elif self.made or self.missing:
            steps.append("compare the tables with those that are here")
        if self.figures:
            steps.append(f"figures: {', '.join(self.figures)}")
        return f"{self.experiment.name}: {'; '.join(steps)}"

    def identity_of_tables(self, read: Mapping[str, str]) -> Identity:
        """What determines the tables, if these files are read to make them."""
        modules, parameters = self._of_runs
        return Identity(
            {
                "parameters": parameters,
                "source": source_digests(*modules),
                "data": read,
                "lock": locked("pandas", *_numerical(*modules)),
            }
        )

    @cached_property
    def _of_runs(self) -> tuple[tuple[str, ...], str]:
        """The modules that runs and tables rest on, and the digest of all parameters."""
        modules = {self.experiment.tabulate.__module__}
        for run in self.runs:
            modules.update(modules_of_run(run.compute, run.parameters))
        of_runs = [
            (run.name, run.compute.__module__, run.compute.__qualname__, run.parameters)
            for run in self.runs
        ]
        return tuple(sorted(modules)), digest(of_runs)

    def _changes_of_tables(self, store: Store) -> list[str]:
        record = store.provenance()
        recorded = _recorded(record, "tables")
        now = self.identity_of_tables(named_digests(_read(recorded), self.store.root))
        return [*now.changes(recorded), *_changed_files(store, record, ".csv")]


def figures_identity(experiment: str, tables: str, read: Iterable[str], results: Path) -> Identity:
    """What determines figures, if the named files are read to draw them.

    ``tables`` is the digest of the tables' identity, which covers the runs as well.
    """
    module = f"softwave_min.figures.{experiment}"
    return Identity(
        {
            "tables": tables,
            "source": source_digests(module),
            "data": named_digests(read, results),
            "lock": locked("matplotlib", "pandas", *_numerical(module)),
        }
    )


def _numerical(*modules: str) -> frozenset[str]:
    return imported_libraries(*modules).intersection(NUMERICAL)


def _recorded(record: Mapping[str, Any], what: str) -> dict[str, Any]:
    parts: dict[str, Any] = record.get("identity", {}).get(what, {})
    return parts


def _read(recorded: Mapping[str, Any]) -> Iterable[str]:
    names: Mapping[str, str] = recorded.get("data", {})
    return names


def _changed_files(store: Store, record: Mapping[str, Any], suffix: str) -> list[str]:
    """The recorded files of a kind that are not as they were written."""
    found = store.file_digests()
    return [
        f"{name} was changed"
        for name, content in record.get("files", {}).items()
        if name.endswith(suffix) and found.get(name) != content
    ]
