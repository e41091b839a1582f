"""Mutation run: change the model in one place at a time and see whether a test notices.

Flips signs, drops factors, swaps sine and cosine, inverts comparisons and adds one to whole
numbers in ``arm`` and ``waves``; the tests of the room must then fail. A mutant that no test
kills must be explained in ``mutation_survivors.md``, by its name.

The run resumes where it was interrupted, and starts anew when source or tests have changed.
"""

from __future__ import annotations

import argparse
import ast
import copy
import hashlib
import importlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOG = ROOT / ".build" / "mutation.jsonl"
EXPLAINED = ROOT / "tests" / "mutation_survivors.md"
ROOMS = {"arm": ("test_arm_*.py",), "waves": ("test_waves_*.py", "test_buoy.py")}
"""Rooms of the package and the tests that answer for them."""
COPIED = ("softwave_min", "tests", "data", "pyproject.toml", "environment.lock")
PRELOADED = (
    "casadi",
    "hypothesis",
    "matplotlib.pyplot",
    "pandas",
    "pydantic",
    "pytest",
    "scipy.optimize",
)

SWAPPED_OPERATORS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
SWAPPED_FUNCTIONS = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}
DROPPED_FUNCTIONS = {"fabs", "abs", "sqrt", "exp", "tanh", "conj"}
FACTORS = (ast.Mult, ast.MatMult, ast.Div)


@dataclass(frozen=True)
class Mutant:
    """One change of one module."""

    module: str
    """Path inside the package."""
    line: int
    name: str
    """Module, function, what was there and what is there now."""
    source: str

    @property
    def room(self) -> str:
        """Part of the package."""
        return self.module.split("/")[0]


def replacements(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in the place of an expression or statement."""
    match node:
        case ast.BinOp(left, operator, right):
            if isinstance(operator, FACTORS):
                yield left
                yield right
            elif isinstance(operator, ast.Pow | ast.FloorDiv | ast.Mod):
                yield left
            else:
                yield from (ast.BinOp(left, other, right) for other in swapped(operator))
        case ast.AugAssign(target, operator, value):
            if isinstance(operator, FACTORS):
                yield ast.Assign([target], value, lineno=node.lineno)
                yield ast.Pass()
            else:
                yield from (ast.AugAssign(target, other, value) for other in swapped(operator))
        case ast.Compare(left, [operator], right):
            yield from (ast.Compare(left, [other], right) for other in swapped(operator))
        case ast.BoolOp(operator, values):
            yield from (ast.BoolOp(other, values) for other in swapped(operator))
        case _:
            yield from replaced_operands(node)


def swapped(operator: ast.AST) -> Iterator[ast.AST]:
    """The opposite operator, if there is one."""
    if type(operator) in SWAPPED_OPERATORS:
        yield SWAPPED_OPERATORS[type(operator)]()


def replaced_operands(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in the place of an expression without a binary operator."""
    match node:
        case ast.UnaryOp(ast.USub() | ast.Not(), operand):
            yield operand
        case ast.Attribute(value, name, context) if name in SWAPPED_FUNCTIONS:
            yield ast.Attribute(value, SWAPPED_FUNCTIONS[name], context)
        case ast.Call(ast.Attribute(_, name), [argument]) if name in DROPPED_FUNCTIONS:
            yield argument
        case ast.Constant(value) if type(value) is int:
            yield ast.Constant(value + 1)


class Sites(ast.NodeVisitor):
    """Places of a module that can be changed, with the function around each."""

    def __init__(self) -> None:
        self.found: list[tuple[str, ast.AST, ast.AST]] = []
        self._around: list[str] = []

    def generic_visit(self, node: ast.AST) -> None:
        """Note a place, then look inside it."""
        self.found += [(".".join(self._around), node, new) for new in replacements(node)]
        super().generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Annotations and decorators are no part of the model."""
        self._inside(node.name, [*node.args.defaults, *node.body])

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        """Decorators and bases neither."""
        self._inside(node.name, node.body)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """Only the value."""
        if node.value is not None:
            self.visit(node.value)

    def visit_Raise(self, node: ast.Raise) -> None:
        """Messages are tested where they are made."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Formatted text neither."""

    def _inside(self, name: str, parts: list[ast.AST]) -> None:
        self._around.append(name)
        for part in parts:
            self.visit(part)
        self._around.pop()


class _Swap(ast.NodeTransformer):
    def __init__(self, old: ast.AST, new: ast.AST) -> None:
        self._old, self._new = old, new

    def visit(self, node: ast.AST) -> ast.AST:
        if node is self._old:
            return self._new
        return self.generic_visit(node)


def mutants(module: Path) -> Iterator[Mutant]:
    """All mutants of a module, in the order of its lines."""
    text = module.read_text(encoding="utf-8")
    place = module.relative_to(ROOT / "softwave_min").as_posix()
    names: Counter[str] = Counter()
    index = 0
    while True:
        tree, visitor = ast.parse(text), Sites()
        visitor.visit(tree)
        if index == len(visitor.found):
            return
        function, old, new = visitor.found[index]
        name = f"{place} {function}: {ast.unparse(old)} -> {ast.unparse(new)}"
        names[name] += 1
        repeated = f" ({names[name]})" if names[name] > 1 else ""
        changed = ast.fix_missing_locations(_Swap(old, copy.deepcopy(new)).visit(tree))
        yield Mutant(place, old.lineno, name + repeated, ast.unparse(changed))
        index += 1


def tests_of(mutant: Mutant) -> list[Path]:
    """Tests that answer for a mutant, those of its module's name first."""
    stem = Path(mutant.module).stem
    return sorted(tests_of_room(mutant.room), key=lambda path: stem not in path.name)


def tests_of_room(room: str) -> list[Path]:
    """Tests that answer for a room, by name."""
    return sorted(path for pattern in ROOMS[room] for path in (ROOT / "tests").glob(pattern))


class Workshop:
    """Copies of the project, in each of which one mutant at a time is tested."""

    def __init__(self, folder: Path, copies: int) -> None:
        self._free = []
        for number in range(copies):
            place = folder / str(number)
            place.mkdir()
            for name in COPIED:
                original = ROOT / name
                if original.is_dir():
                    ignored = shutil.ignore_patterns("__pycache__")
                    shutil.copytree(original, place / name, ignore=ignored)
                else:
                    shutil.copy(original, place / name)
            self._free.append(place)
        self._running: dict[int, tuple[Path, Mutant | None, float]] = {}

    def start(self, mutant: Mutant | None, tests: list[Path], limit: float) -> None:
        """Run tests on a mutant, or on the source as it is."""
        place = self._free.pop()
        if mutant is not None:
            (place / "softwave_min" / mutant.module).write_text(mutant.source, encoding="utf-8")
        # The parent has the libraries in memory; a child begins with them.
        child = os.fork()
        if child == 0:
            sys.dont_write_bytecode = mutant is not None
            _test(place, tests, limit)
        self._running[child] = place, mutant, time.monotonic()

    def finish(self) -> tuple[Mutant | None, str, float]:
        """Wait for a run to end: its mutant, what became of it, and the time it took, in s."""
        child, status = os.wait()
        place, mutant, started = self._running.pop(child)
        if mutant is not None:
            module = Path("softwave_min") / mutant.module
            shutil.copy(ROOT / module, place / module)
        self._free.append(place)
        return mutant, _outcome(status), time.monotonic() - started

    def unmutated(self, room: str) -> float:
        """Run the tests of a room in every copy; the time to grant them, in s."""
        while self._free:
            self.start(None, tests_of_room(room), limit=1200)
        runs = [self.finish() for _ in range(len(self._running))]
        if any(outcome != "survived" for _, outcome, _ in runs):
            raise SystemExit(f"mutation: the tests of {room} fail without any mutation")
        return 30 + 5 * max(seconds for *_, seconds in runs)

    @property
    def busy(self) -> int:
        """Runs under way."""
        return len(self._running)

    @property
    def free(self) -> int:
        """Copies at rest."""
        return len(self._free)


def _test(place: Path, tests: list[Path], limit: float) -> None:
    """Become a test run; the process ends with it."""
    os.nice(10)
    os.chdir(place)
    sys.path.insert(0, str(place))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    # The default action ends the process, whatever library it is in.
    signal.alarm(int(limit))
    import pytest

    files = [str(place / path.relative_to(ROOT)) for path in tests]
    # Without the other plugins, which take longer to load than many a mutant to die.
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    options = ["-x", "--tb=no", "-W", "ignore", "-p", "_hypothesis_pytestplugin"]
    options.append("--hypothesis-profile=mutation")
    os._exit(pytest.main([*options, *files]))


def _outcome(status: int) -> str:
    if os.WIFSIGNALED(status):
        return "timeout" if os.WTERMSIG(status) == signal.SIGALRM else "killed"
    match os.WEXITSTATUS(status):
        case 0:
            return "survived"
        case 1 | 2:  # a test failed, or could not even be imported
            return "killed"
        case code:
            raise SystemExit(f"mutation: pytest ended with status {code}")


class Log:
    """What became of each mutant, kept as long as source and tests stay as they are."""

    def __init__(self, inputs: str, *, keep: bool) -> None:
        self.outcomes: dict[str, str] = {}
        lines = LOG.read_text(encoding="utf-8").splitlines() if LOG.is_file() else []
        if lines and (keep or lines[0] == inputs):
            entries = [json.loads(line) for line in lines[1:]]
            self.outcomes = {entry["mutant"]: entry["outcome"] for entry in entries}
        LOG.parent.mkdir(parents=True, exist_ok=True)
        kept = [json.dumps({"mutant": m, "outcome": o}) for m, o in self.outcomes.items()]
        LOG.write_text("\n".join([inputs, *kept, ""]), encoding="utf-8")

    def add(self, mutant: Mutant, outcome: str) -> None:
        """Record an outcome at once."""
        self.outcomes[mutant.name] = outcome
        with LOG.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps({"mutant": mutant.name, "outcome": outcome}) + "\n")


def inputs_digest() -> str:
    """Hash of the source that is changed and of the tests."""
    digest = hashlib.sha256()
    for folder in (*(f"softwave_min/{room}" for room in ROOMS), "tests"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def explained() -> set[str]:
    """Names of the mutants that `mutation_survivors.md` explains: the items of its lists."""
    lines = EXPLAINED.read_text(encoding="utf-8").splitlines()
    return {line[3:].split("`")[0] for line in lines if line.startswith("- `")}


def main() -> int:
    """Run what the log does not have, print the score and the survivors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--only", default="", help="mutants whose name has this in it")
    parser.add_argument("--list", action="store_true", help="print the mutants and stop")
    parser.add_argument(
        "--survivors", action="store_true", help="test again those that survived, trust the rest"
    )
    arguments = parser.parse_args()
    modules = [path for room in ROOMS for path in (ROOT / "softwave_min" / room).glob("*.py")]
    every = [mutant for module in sorted(modules) for mutant in mutants(module)]
    chosen = [mutant for mutant in every if arguments.only in mutant.name]
    if arguments.list:
        print("\n".join(mutant.name for mutant in chosen))
        return 0
    log = Log(inputs_digest(), keep=arguments.survivors)
    known = {name for name, outcome in log.outcomes.items() if outcome != "survived"}
    if not arguments.survivors:
        known = set(log.outcomes)
    run([mutant for mutant in chosen if mutant.name not in known], log, arguments.jobs)
    return report(chosen, log)


def run(todo: list[Mutant], log: Log, jobs: int) -> None:
    """Test the mutants, several at a time."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for name in PRELOADED:
        importlib.import_module(name)
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        workshop = Workshop(Path(folder), jobs)
        limits = {room: workshop.unmutated(room) for room in sorted({m.room for m in todo})}
        started = time.monotonic()
        for number, mutant in enumerate(todo, start=1):
            if not workshop.free:
                finish(workshop, log)
            workshop.start(mutant, tests_of(mutant), limits[mutant.room])
            if number % 20 == 0:
                minutes = (time.monotonic() - started) / 60
                print(f"{number} of {len(todo)} in {minutes:.0f} min", flush=True)
        while workshop.busy:
            finish(workshop, log)


def finish(workshop: Workshop, log: Log) -> None:
    """Wait for one run and record it."""
    mutant, outcome, _ = workshop.finish()
    log.add(mutant, outcome)
    if outcome == "survived":
        print(f"survived: line {mutant.line}, {mutant.name}", flush=True)


def report(chosen: list[Mutant], log: Log) -> int:
    """Print the score; 1 if a survivor is not explained, or an explained one is gone."""
    outcomes = [(mutant, log.outcomes[mutant.name]) for mutant in chosen]
    survivors = [mutant for mutant, outcome in outcomes if outcome == "survived"]
    reasons = explained()
    surprising = [mutant for mutant in survivors if mutant.name not in reasons]
    for room in ROOMS:
        of_room = [outcome for mutant, outcome in outcomes if mutant.room == room]
        killed = len(of_room) - of_room.count("survived")
        print(f"{room}: {killed} of {len(of_room)} killed")
    equivalent = len(survivors) - len(surprising)
    print(
        f"score: {len(chosen) - len(survivors)} of {len(chosen)} killed,"
        f" {equivalent} survivors explained, {len(surprising)} not"
    )
    for mutant in surprising:
        print(f"not explained: line {mutant.line}, `{mutant.name}`")
    return 1 if surprising else 0


if __name__ == "__main__":
    sys.exit(main())
