"""The command line: ``python -m softwave_min``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from softwave_min.compare import committed_table, compare_tables, table_stems
from softwave_min.experiments import NAMES, Experiment, experiment
from softwave_min.figures import style
from softwave_min.native import description
from softwave_min.parameters import ParameterError, ParameterSet, data_folder, load_parameters
from softwave_min.store import Store, write_atomically
from softwave_min.sweep import (
    Freshness,
    SweepError,
    compute,
    figures_identity,
    file_digests,
    freshness,
)

__all__ = ["main"]

USER_ERROR = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status."""
    options = _parser().parse_args(arguments)
    try:
        status: int = options.command(options)
    except ParameterError as error:
        print(error, file=sys.stderr)
        return USER_ERROR
    except SweepError as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted; finished runs are kept", file=sys.stderr)
        return 130
    return status


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m softwave_min",
        description="Experiments of the companion: compute them, judge them, compare them.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    listing = commands.add_parser("list", help="list the experiments")
    listing.set_defaults(command=_list)

    run = commands.add_parser("run", help="compute what is missing or stale, with its figures")
    run.add_argument("--jobs", type=_positive, default=os.cpu_count() or 1, metavar="N")
    run.set_defaults(command=_run)

    status = commands.add_parser("status", help="say what is fresh and what is stale")
    status.set_defaults(command=_status)

    figures = commands.add_parser("figures", help="draw every figure anew from the results")
    figures.set_defaults(command=_figures)

    for command in (run, status, figures):
        command.add_argument("names", nargs="*", metavar="NAME", help="experiments; all if none")
        command.add_argument(
            "--parameters",
            type=Path,
            default=data_folder() / "parameters" / "calibrated.toml",
            metavar="FILE",
            help="parameter set, a TOML file (default: data/parameters/calibrated.toml)",
        )

    compare = commands.add_parser("compare", help="compare the tables with the committed ones")
    compare.add_argument("names", nargs="*", metavar="NAME")
    compare.add_argument("--strict", action="store_true", help="exit with 1 if any differ")
    compare.set_defaults(command=_compare)
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not a number of processes, 1 or more")
    return value


def _chosen(options: argparse.Namespace) -> list[Experiment]:
    try:
        return [experiment(name) for name in options.names or NAMES]
    except KeyError as error:
        raise ParameterError(error.args[0]) from None


def _list(_: argparse.Namespace) -> int:
    for name in NAMES:
        print(f"{name:20} {experiment(name).title}")
    return 0


def _run(options: argparse.Namespace) -> int:
    parameters = load_parameters(options.parameters)
    chosen = _chosen(options)
    print(f"controllers and plant: {description()}")
    for one in chosen:
        store = Store(one.name)
        count = compute(one, parameters, store, options.jobs)
        drawn = _draw_if_stale(one, parameters, store)
        news = [f"{count} runs computed"] * bool(count) + ["figures drawn"] * drawn
        print(f"{one.name}: {', '.join(news) or 'up to date'}")
    return 0


def _draw_if_stale(one: Experiment, parameters: ParameterSet, store: Store) -> bool:
    record = store.provenance()
    identity = figures_identity(one, parameters)
    current = record.get("figures_identity") == identity and record["files"] == file_digests(store)
    if not current:
        _draw(one, parameters, store)
    return not current


def _draw(one: Experiment, parameters: ParameterSet, store: Store) -> None:
    style.apply()
    module = import_module(f"softwave_min.figures.{one.name}")
    drawings: dict[str, style.Drawing] = module.draw(store, parameters)
    for stem, drawing in drawings.items():
        write_atomically(store.folder / f"{stem}.svg", style.svg(drawing))
        for suffix, film in drawing.media.items():
            write_atomically(store.folder / f"{stem}.{suffix}", film)
    store.write_provenance(
        {
            **store.provenance(),
            "figures_identity": figures_identity(one, parameters),
            "figures": {
                stem: {"caption": drawing.caption, "alt": drawing.alt}
                for stem, drawing in drawings.items()
            },
            "files": file_digests(store),
        }
    )


def _figures(options: argparse.Namespace) -> int:
    parameters = load_parameters(options.parameters)
    for one in _chosen(options):
        _draw(one, parameters, Store(one.name))
        print(f"{one.name}: figures drawn")
    return 0


def _status(options: argparse.Namespace) -> int:
    parameters = load_parameters(options.parameters)
    stale = 0
    for one in _chosen(options):
        found = freshness(one, parameters, Store(one.name))
        print(f"{one.name}: {found.value}")
        stale += found is Freshness.STALE
    if stale:
        print(f"{stale} of the results are stale: run 'make all'", file=sys.stderr)
    return 1 if stale else 0


def _compare(options: argparse.Namespace) -> int:
    differ = 0
    for one in _chosen(options):
        store = Store(one.name)
        for stem in table_stems(store.folder):
            outcome = compare_tables(stem, store.read_table(stem), committed_table(one.name, stem))
            print(f"{one.name}/{stem}.csv: {outcome.text}")
            differ += not outcome.agrees
    return 1 if options.strict and differ else 0


if __name__ == "__main__":
    sys.exit(main())
