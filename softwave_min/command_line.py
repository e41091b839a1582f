"""What may be asked on the command line, and how it answers when that goes wrong."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from softwave_min import commands
from softwave_min.data import ParameterError
from softwave_min.native import CompilerError
from softwave_min.parameters import DEFAULT_SET, SET_NAMES
from softwave_min.runs.compare import NoRepositoryError

FAILED = 1
USER_ERROR = 2
INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the exit status.

    0: done; 1: something failed, is stale or differs; 2: what was asked cannot be done,
    one line says why; 130: interrupted.
    """
    options = _parser().parse_args(arguments)
    try:
        status: int = options.command(options)
    except (ParameterError, OSError) as error:
        print(error, file=sys.stderr)
        return USER_ERROR
    except RuntimeError as error:
        if not isinstance(error, _failures()):
            raise
        print(error, file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print("interrupted; finished runs are kept", file=sys.stderr)
        return INTERRUPTED
    return status


def _failures() -> tuple[type[RuntimeError], ...]:
    """What a line is enough for; imported where something failed, since it brings everything."""
    from softwave_min.paper.claims import ClaimError  # noqa: PLC0415
    from softwave_min.runs.sweep import SweepError  # noqa: PLC0415

    return (SweepError, CompilerError, ClaimError, NoRepositoryError)


class _Parser(argparse.ArgumentParser):
    """Refuses in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(USER_ERROR, f"{self.prog}: {message}; --help explains\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="python -m softwave_min",
        description="Experiments of the companion: compute them, judge them, compare them.",
        epilog="Exit status: 0 done; 1 something failed, is stale or differs; "
        "2 what was asked cannot be done; 130 interrupted, finished runs are kept.",
    )
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for command, about, options in (
        (commands.list_experiments, "list the experiments", ()),
        (
            commands.run,
            "compute what is missing or stale, with its figures",
            (_names, _workers, _results, _manner),
        ),
        (commands.status, "say what is fresh and what is stale", (_names, _results)),
        (commands.figures, "draw every figure anew from the results", (_names, _results)),
        (commands.claims, "judge the paper's claims by the results", (_results,)),
        (
            commands.compare,
            "compare the tables with the committed ones",
            (_names, _results, _strict),
        ),
        (
            commands.verify,
            "compute anew in a folder of its own and compare with the committed tables",
            (_names, _workers),
        ),
    ):
        name = command.__name__.partition("_")[0]
        one = subparsers.add_parser(name, help=about, description=f"{about.capitalize()}.")
        one.set_defaults(command=command, results=None)
        for add in (*options, _parameters):
            add(one)
    search = subparsers.add_parser(
        "calibrate",
        help="search for the parameter set that comes closest to the paper's numbers",
        description="Search as data/studies/calibration.toml says; goes on where it was "
        "interrupted.",
    )
    search.set_defaults(command=commands.calibrate)
    search.add_argument(
        "--write", action="store_true", help=f"make the best one the set {DEFAULT_SET!r}"
    )
    study = subparsers.add_parser(
        "sensitivity",
        help="find out which of the open parameters decide the headline numbers",
        description="Judge the sets that data/studies/sensitivity.toml asks for; goes on where "
        "it was interrupted.",
    )
    study.set_defaults(command=commands.sensitivity)
    for one in (search, study):
        _workers(one)
        _results(one)
    return parser


def _names(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "names",
        nargs="*",
        metavar="EXPERIMENT",
        help="name from 'list'; none: all, but compute those 'on request' only when named",
    )


def _parameters(parser: argparse.ArgumentParser) -> None:
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--set",
        metavar="NAME",
        help=f"parameter set: {' or '.join(SET_NAMES)} (default: {DEFAULT_SET})",
    )
    source.add_argument("--parameters", type=Path, metavar="FILE", help="one of your own, as TOML")
    parser.add_argument(
        "--seeds",
        type=_positive,
        metavar="N",
        help="random seas for each case (default: sea.realisations of the set)",
    )


def _results(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--results",
        type=Path,
        metavar="FOLDER",
        help="folder of the results (default: results/; for anything but the default set and "
        "its number of seas, a folder of its own in results/sets/)",
    )


def _manner(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--dry-run", action="store_true", help="say what is missing or stale, and why; no more"
    )
    parser.add_argument(
        "--record",
        action="store_true",
        help="write the tables made here to be committed, even where the committed ones agree",
    )


def _strict(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--strict", action="store_true", help="exit with 1 if any differ")


def _workers(parser: argparse.ArgumentParser) -> None:
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        "--jobs",
        type=_positive,
        metavar="N",
        help="processes on this machine (default: as many as it has processors)",
    )
    who.add_argument(
        "--scheduler", metavar="ADDRESS", help="compute on a running Dask cluster, e.g. host:8786"
    )


def _positive(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number, 1 or more")
    return int(text)
