"""Tables: made of the runs that are here, and written where they are committed if need be."""

from __future__ import annotations

from typing import Any

from softwave_min.data import recording
from softwave_min.native import description
from softwave_min.runs.compare import compare_texts, tolerances_of
from softwave_min.runs.experiment import Tables
from softwave_min.runs.identity import as_plain, file_digests
from softwave_min.runs.plan import Task
from softwave_min.runs.store import Store, machine, repository_state, write_atomically


def make_tables(task: Task, wall_time: float | None) -> None:
    """Make the tables of all runs, and keep them with what they came from beside the runs.

    ``wall_time`` is that of the runs, in s; None where none was computed for the experiment.
    """
    experiment, store = task.experiment, task.store
    arrays = {run.name: store.load_run(run) for run in task.runs}
    with recording() as read:
        tables: Tables = experiment.tabulate(task.parameters, arrays)
    made = store.made
    for stem in set(made.stems()) - tables.keys():
        (made.folder / f"{stem}.csv").unlink()
    for stem, table in tables.items():
        made.write_table(stem, table)
    common = {
        "engine": description(),
        "machine": machine(),
        "parameters": as_plain(task.parameters),
        **repository_state(),
    }
    identity = task.identity_of_tables(file_digests(read, store.root))
    made.write_provenance(
        {
            "experiment": experiment.name,
            "title": experiment.title,
            "claims": experiment.claims,
            "identity": {"tables": identity.parts},
            "runs": {run.name: _in_particular(store.run_record(run), common) for run in task.runs},
            **({} if wall_time is None else {"wall_time": round(wall_time, 3)}),
            "files": made.file_digests(),
            **common,
        }
    )


def publish(task: Task, *, record: bool) -> bool:
    """Write the tables made here where they are committed, unless those there are as good.

    They are if they are of the present inputs, and agree with those made here within their
    tolerances; ``record`` asks for these ones nevertheless.

    Returns
    -------
    bool
        Whether they were written.
    """
    store, made = task.store, task.store.made
    if not task.tables and (_is_from(made, store) if record else _agree(task)):
        return False
    for stem in made.stems():
        name = f"{stem}.csv"
        write_atomically(store.folder / name, (made.folder / name).read_bytes())
    store.write_provenance({**made.provenance(), "files": store.file_digests()})
    return True


def _agree(task: Task) -> bool:
    store, made = task.store, task.store.made
    return all(
        compare_texts(
            made.table_text(stem),
            store.table_text(stem),
            tolerances_of(task.experiment.tolerances, stem),
        ).agrees
        for stem in made.stems()
    )


def _is_from(made: Store, store: Store) -> bool:
    """Whether all that was written comes from the tables made here."""
    here, there = made.provenance(), store.provenance()
    return all(
        there.get(key) == value for key, value in here.items() if key not in {"files", "identity"}
    ) and all(there["files"].get(name) == content for name, content in here["files"].items())


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
    if tree.keys() != common.keys():
        return {key: _reduced(value, common) for key, value in tree.items()}
    return {
        key: _reduced(value, common[key]) for key, value in tree.items() if value != common[key]
    }
