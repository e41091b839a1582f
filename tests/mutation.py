"""Mutation run: change a room in one place at a time and see whether one of its tests notices.

cosmic-ray makes the changes and keeps what became of each. Ours are the rooms, two operators for
what formulas are made of, names that outlive a line that moves, the forked test run, and the
report: a mutant that no test kills must be explained by its name in ``mutation_survivors.md``.

Tests draw few random examples first, the last killer ahead; survivors meet all examples. A run
resumes where it was interrupted, and starts anew when the room's source or its tests have changed.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code, use_mutation
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import OPERATOR_PROVIDERS, get_operator
from cosmic_ray.work_db import use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome, WorkerOutcome, WorkItem, WorkResult
from parso.tree import NodeOrLeaf

ROOT = Path(__file__).resolve().parent.parent
LOGS = ROOT / ".build" / "mutation"
EXPLAINED = ROOT / "tests" / "mutation_survivors.md"
PACKAGE = Path("softwave_min")
ROOMS = {"arm": ["tests/arm"], "waves": ["tests/waves"]}
"""Folders of the package, each with the tests that answer for it."""
PRELOADED = ("casadi", "hypothesis", "matplotlib.pyplot", "pandas", "pydantic", "scipy.optimize")
PYTEST = ["-x", "--ff", "--tb=no", "-Wignore", "-oaddopts=", "-p_hypothesis_pytestplugin"]
STAGES = (
    ["--hypothesis-profile=mutation"],
    ["--hypothesis-profile=reproducible", "-m", "hypothesis"],
)
"""All tests with few random examples, then with all examples those that draw any."""
DAY, LATE, OUTPUT = 86400, "stopped by its limit", "tests.log"
COPIED = ("softwave_min", "tests", "data", "pyproject.toml", "environment.lock")

SWAPPED = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}
SWAPPED |= {"+=": "-=", "-=": "+=", "*=": "=", "/=": "="}
DROPPED = {"abs", "conj", "exp", "expm1", "fabs", "log", "sqrt", "tanh"}


class Ours(Operator):
    """An operator by what may stand in the place of a leaf's value or of a node's children."""

    def others(self, node: NodeOrLeaf) -> Iterator[str | list[NodeOrLeaf]]:
        raise NotImplementedError

    def mutation_positions(self, node):
        return [(node.start_pos, node.end_pos) for _ in self.others(node)]

    def mutate(self, node, index):
        other = list(self.others(node))[index]
        setattr(node, "value" if isinstance(other, str) else "children", other)
        return node

    @classmethod
    def examples(cls):
        return ()


class Swap(Ours):
    """Sine and cosine, operations in place, membership, and a number for the next one."""

    def others(self, node):
        match node.type, getattr(node, "value", None), getattr(node.parent, "type", None):
            case "number", digits, _:
                yield repr(ast.literal_eval(digits) + 1)
            case _, "in", "comparison":
                yield "not in"
            case _, "not", "comp_op":
                yield ""
            case _, word, _ if word in SWAPPED:
                yield SWAPPED[word]


class Drop(Ours):
    """A factor, an exponent, or a function around its argument left out."""

    def others(self, node):
        parts = getattr(node, "children", [])
        if node.type in ("term", "power"):
            if node.type == "term":
                yield parts[2:]
            yield from (parts[:at] + parts[at + 2 :] for at in range(1, len(parts), 2))
        elif node.type == "atom_expr":
            for at, (name, call) in enumerate(pairwise(parts)):
                if name.get_last_leaf().value not in DROPPED or call.type != "trailer":
                    continue
                if len(call.children) == 2:  # a method: x.conj()
                    yield parts[:at] + parts[at + 2 :]
                elif at < 2 and call.children[1].type not in ("arglist", "argument"):
                    yield parts[at + 1 :]


OPERATOR_PROVIDERS["ours"] = {"Swap": Swap, "Drop": Drop}
OPERATORS = [
    "ours/Swap",
    "ours/Drop",
    *(f"core/ReplaceBinaryOperator_{signs}" for signs in ("Add_Sub", "Sub_Add")),
    *(f"core/ReplaceUnaryOperator_Delete_{sign}" for sign in ("USub", "Not")),
    *(f"core/Replace{words}" for words in ("AndWithOr", "OrWithAnd")),
    *(
        f"core/ReplaceComparisonOperator_{one}_{other}"
        for pair in (("Eq", "NotEq"), ("Is", "IsNot"), ("Lt", "GtE"), ("Gt", "LtE"))
        for one, other in (pair, pair[::-1])
    ),
]
SIGNS = (ast.operator, ast.unaryop, ast.cmpop, ast.boolop)


def change(old: ast.AST, new: ast.AST) -> str | None:
    """Function, what was there and what is there now; messages are no part of the model."""
    around = []
    while not isinstance(old, ast.Raise | ast.JoinedStr) and ast.dump(old) != ast.dump(new):
        if isinstance(old, ast.FunctionDef | ast.ClassDef):
            around.append(old.name)
        pairs = zip(ast.iter_child_nodes(old), ast.iter_child_nodes(new), strict=False)
        within = [(a, b) for a, b in pairs if ast.dump(a) != ast.dump(b)]
        if type(old) is not type(new) or len(within) != 1 or isinstance(within[0][0], SIGNS):
            return f"{'.'.join(around)}: {ast.unparse(old)} -> {ast.unparse(new)}"
        ((old, new),) = within
    return None


def mutants(room: str) -> Iterator[WorkItem]:
    """All mutants of a room in the order of its lines, under names of which no two are alike."""
    for module in sorted((ROOT / PACKAGE / room).rglob("*.py")):
        path, source = module.relative_to(ROOT), module.read_text(encoding="utf-8")
        nodes, tree, found = list(ast_nodes(get_ast(source))), ast.parse(source), []
        for operator in OPERATORS:
            made = get_operator(operator)()
            places = [place for node in nodes for place in made.mutation_positions(node)]
            for number, place in enumerate(places):
                if what := change(tree, ast.parse(mutate_code(source, made, number))):
                    found.append((what, MutationSpec(path, operator, number, *place)))
        met: Counter[str] = Counter()
        for what, spec in sorted(found, key=lambda mutant: mutant[1].start_pos):
            met[what] += 1
            name = f"{path.relative_to(PACKAGE).as_posix()} {what}"
            yield WorkItem.single(name + (f" ({met[what]})" if met[what] > 1 else ""), spec)


def database(room: str, *, again: bool) -> Path:
    """Results for this source and these tests; ``again`` takes over those of other tests."""

    def digest(*places: str) -> str:
        files = sorted(file for place in places for file in (ROOT / place).rglob("*.py"))
        return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]

    source = f"{room}-{digest(f'{PACKAGE}/{room}')}"
    path = LOGS / f"{source}-{digest(*ROOMS[room], 'tests/helpers')}.db"
    LOGS.mkdir(parents=True, exist_ok=True)
    former = sorted(LOGS.glob(f"{source}-*.db"), key=lambda file: file.stat().st_mtime)
    if again and former and not path.exists():
        former[-1].rename(path)
    return path


def settle(folder: str) -> None:
    """Begin a process: its place is a copy of the project, in which it mutates."""
    place = Path(tempfile.mkdtemp(dir=folder))
    for name in COPIED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        copy(ROOT / name, place / name)
    os.chdir(place)


def fork_tests(room: str, stage: list[str], limit: int) -> tuple[int, float]:
    """Exit status and processor time, in s, of the tests in a child, which has the libraries."""
    child = os.fork()
    if child == 0:
        # Processor time, not a clock's: the machine may have other work.
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
        signal.alarm(20 * limit)
        output = os.open(OUTPUT, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        sys.path.insert(0, os.getcwd())
        status = pytest.main([*PYTEST, *stage, *ROOMS[room]])
        sys.stdout.flush()
        os._exit(status)
    _, status, usage = os.wait4(child, 0)
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime


def unmutated(room: str) -> list[int]:
    """Limits of each stage, in s, after what it takes without a mutation; it must pass."""
    limits = []
    for stage in STAGES:
        status, seconds = fork_tests(room, stage, DAY)
        if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
            raise RuntimeError(f"tests fail without a mutation:\n{Path(OUTPUT).read_text()}")
        limits.append(60 + 5 * int(seconds))
    return limits


def tested(room: str, limits: list[int], item: WorkItem) -> tuple[str, WorkResult]:
    """Name of a mutant and what became of it."""
    sys.dont_write_bytecode = True
    (spec,) = item.mutations
    with use_mutation(spec.module_path, get_operator(spec.operator_name)(), spec.occurrence):
        for stage, limit in zip(STAGES, limits, strict=True):
            status, _ = fork_tests(room, stage, limit)
            if status not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
                late = status in (-signal.SIGXCPU, -signal.SIGALRM)
                output = LATE if late else Path(OUTPUT).read_text(encoding="utf-8")
                return item.job_id, WorkResult(WorkerOutcome.NORMAL, output, TestOutcome.KILLED)
    return item.job_id, WorkResult(WorkerOutcome.NORMAL, "", TestOutcome.SURVIVED)


def run(room: str, todo: list[WorkItem], jobs: int) -> Iterator[tuple[str, WorkResult]]:
    """Test mutants in copies of the project, several at a time, and say how it goes."""
    os.environ |= {"OPENBLAS_NUM_THREADS": "1", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    for library in PRELOADED:
        importlib.import_module(library)
    processes = multiprocessing.get_context("fork")
    with (
        tempfile.TemporaryDirectory(prefix="mutation-") as folder,
        processes.Pool(jobs, settle, (folder,)) as pool,
    ):
        limits = pool.apply(unmutated, (room,))
        ended = pool.imap_unordered(partial(tested, room, limits), todo)
        for number, (name, result) in enumerate(ended, start=1):
            if not result.is_killed or number % 20 == 0:
                print(f"{number} of {len(todo)}: {result.test_outcome.value}, {name}", flush=True)
            yield name, result


def examine(room: str, asked: argparse.Namespace) -> dict[str, WorkResult]:
    """What became of the mutants that are asked for; those not known yet are tested."""
    with use_db(database(room, again=asked.survivors)) as db:
        if not db.num_work_items:
            db.add_work_items(mutants(room))
        known = {name for name, result in db.results if result.is_killed or not asked.survivors}
        chosen = [item for item in db.work_items if asked.only in item.job_id]
        if todo := [item for item in chosen if item.job_id not in known]:
            for name, result in run(room, todo, asked.jobs):
                db.set_result(name, result)
        results = dict(db.results)
        return {item.job_id: results[item.job_id] for item in chosen}


def main() -> int:
    """Test the mutants that are not known yet; print the scores and what they leave open."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--room", choices=ROOMS, help="this room alone")
    parser.add_argument("--only", default="", help="mutants whose name has this in it")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    again = "test again those that survived; what older tests killed stays dead"
    parser.add_argument("--survivors", action="store_true", help=again)
    asked = parser.parse_args()
    os.nice(10)
    lines = EXPLAINED.read_text(encoding="utf-8").splitlines()
    reasons = {line[3:].split("`")[0] for line in lines if line.startswith("- `")}
    surprises = 0
    for room in [asked.room] if asked.room else ROOMS:
        known = examine(room, asked)
        alive = {name for name, result in known.items() if not result.is_killed}
        late = sum(result.output == LATE for result in known.values())
        print(f"{room}: {len(known) - len(alive)} of {len(known)} killed, {late} by the time limit")
        own = {name for name in reasons if name.startswith(f"{room}/") and asked.only in name}
        for name in sorted(alive ^ own):
            fault = "survives without an explanation" if name in alive else "does not survive"
            print(f"{fault}: `{name}`")
        surprises += len(alive ^ own)
    return 1 if surprises else 0


if __name__ == "__main__":
    sys.exit(main())
