"""Mutation run: change the model in one place at a time and see whether a test notices.

Flips signs, drops factors, swaps sine and cosine, inverts comparisons and adds one to whole
numbers in ``arm`` and ``waves``; the tests of the room must then fail. A mutant meets the
tests with few random examples first, those ahead that killed its neighbours; the survivors
of all these meet all random examples. One that no test kills must be explained in
``mutation_survivors.md``, by its name. The scores are kept there as well.

The run resumes where it was interrupted, and starts a room anew when its source or its tests
have changed.
"""

from __future__ import annotations

import argparse
import ast
import copy
import gc
import hashlib
import importlib
import json
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LOGS = ROOT / ".build" / "mutation"
EXPLAINED = ROOT / "tests" / "mutation_survivors.md"


@dataclass(frozen=True)
class Room:
    """A part of the package and what answers for it, as patterns of names in ``tests``."""

    tests: tuple[str, ...]
    helpers: tuple[str, ...] = ()


ROOMS = {
    "arm": Room(("test_arm_*.py",), ("arm_*.py",)),
    "waves": Room(("test_waves_*.py", "test_buoy.py")),
}
COPIED = ("softwave_min", "tests", "data", "pyproject.toml", "environment.lock")
PRELOADED = (
    "casadi",
    "hypothesis",
    "matplotlib.pyplot",
    "pandas",
    "pydantic",
    "scipy.optimize",
)

QUICK, THOROUGH = "mutation", "reproducible"
"""Profiles of Hypothesis in ``conftest.py``: few examples, and all."""
UNDECIDED = ("", "suspect")
"""Outcomes before the tests with few and before those with all examples."""

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
    original: str
    source: str


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
        yield Mutant(place, old.lineno, name + repeated, text, ast.unparse(changed))
        index += 1


class Order:
    """Plug-in of pytest: the likeliest killers first, and which test it was."""

    def __init__(self, likely: dict[str, float], report: Path, profile: str) -> None:
        self._likely, self._report, self.profile = likely, report, profile
        self._seen: dict[str, float] = {}

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort; with all examples, only the tests that draw any."""
        if self.profile == THOROUGH:
            items[:] = [i for i in items if hasattr(getattr(i, "obj", None), "hypothesis")]
        items.sort(key=lambda item: -self._likely.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note the time that each test takes, and the one that fails."""
        self._seen[report.nodeid] = self._seen.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self._write(report.nodeid)
            os._exit(1)  # pytest would take longer to end than most mutants to die

    def pytest_sessionfinish(self, exitstatus: int) -> None:
        """Report the times if all passed."""
        if exitstatus == 0:
            self._write("")

    def _write(self, killer: str) -> None:
        self._report.write_text(json.dumps({"by": killer, "seconds": self._seen}))


@dataclass(frozen=True)
class Ended:
    """How a run of tests ended."""

    mutant: Mutant | None
    outcome: str
    """survived, killed or timeout; suspect in the log if it survived the quick tests alone."""
    by: str
    """The test that failed."""
    seconds: dict[str, float]
    """Time of each test."""
    processor: float
    """Processor time of the whole, in s."""


class Workshop:
    """Copies of the project, in each of which one mutant at a time is tested."""

    def __init__(self, folder: Path, copies: int, room: str) -> None:
        self._room, self._limit = ROOMS[room], 1200.0
        self._seconds: dict[str, float] = {}
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
        self._running: dict[int, tuple[Path, Mutant | None]] = {}

    def start(self, mutant: Mutant | None, log: Log, profile: str) -> None:
        """Run the tests on a mutant, or on the source as it is."""
        place = self._free.pop()
        likely = {}
        if mutant is not None:
            (place / "softwave_min" / mutant.module).write_text(mutant.source, encoding="utf-8")
            likely = log.likely(mutant, self._seconds)
        # The parent has the libraries in memory; a child begins with them.
        child = os.fork()
        if child == 0:
            sys.dont_write_bytecode = mutant is not None
            tests = [str(path) for path in matching(place / "tests", self._room.tests)]
            _test(place, tests, Order(likely, place / "ended.json", profile), self._limit)
        self._running[child] = place, mutant

    def finish(self) -> Ended:
        """Wait for a run to end."""
        child, status, usage = os.wait4(-1, 0)
        place, mutant = self._running.pop(child)
        if mutant is not None:
            (place / "softwave_min" / mutant.module).write_text(mutant.original, encoding="utf-8")
        self._free.append(place)
        report, found = place / "ended.json", {"by": "", "seconds": {}}
        if report.is_file():
            found = json.loads(report.read_text())
            report.unlink()
        spent = usage.ru_utime + usage.ru_stime
        return Ended(mutant, _outcome(status), found["by"], found["seconds"], spent)

    def unmutated(self, log: Log) -> None:
        """Run the tests once without a mutation: they must pass; what they take is the measure."""
        self.start(None, log, QUICK)
        run = self.finish()
        if run.outcome != "survived":
            raise SystemExit(f"mutation: without any mutation fails {run.by or 'all'}")
        self._seconds = run.seconds
        self._limit = 60 + 5 * run.processor

    @property
    def busy(self) -> int:
        """Runs under way."""
        return len(self._running)

    @property
    def free(self) -> int:
        """Copies at rest."""
        return len(self._free)


def _test(place: Path, tests: list[str], order: Order, limit: float) -> None:
    """Become a test run; the process ends with it."""
    os.nice(10)
    os.chdir(place)
    sys.path.insert(0, str(place))
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    # Processor time, not a clock's: the machine may have other work. The signal's default
    # action ends the process, whatever library it is in.
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
    # Without the other plugins, which take longer to load than many a mutant to die.
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    options = ["-x", "--tb=no", "-W", "ignore", "-p", "_hypothesis_pytestplugin"]
    options += ["-p", "no:cacheprovider", f"--hypothesis-profile={order.profile}"]
    os._exit(pytest.main([*options, *tests], plugins=[order]))


def _outcome(status: int) -> str:
    if os.WIFSIGNALED(status):
        return "timeout" if os.WTERMSIG(status) == signal.SIGXCPU else "killed"
    match os.WEXITSTATUS(status):
        case 0:
            return "survived"
        case 1 | 2:  # a test failed, or could not even be imported
            return "killed"
        case code:
            raise SystemExit(f"mutation: pytest ended with status {code}")


def matching(folder: Path, patterns: Iterable[str]) -> list[Path]:
    """Files of a folder by patterns of their names."""
    return sorted(path for pattern in patterns for path in folder.glob(pattern))


def digest(paths: Iterable[Path]) -> str:
    """Hash of some files."""
    total = hashlib.sha256()
    for path in paths:
        total.update(path.read_bytes())
    return total.hexdigest()[:12]


class Log:
    """What became of each mutant of a room, and by which test.

    Kept as long as the room's source and tests stay as they are. With ``trusting``, new
    tests leave what was killed as dead.
    """

    def __init__(self, room: str, *, trusting: bool) -> None:
        source = digest(sorted((ROOT / "softwave_min" / room).rglob("*.py")))
        used = matching(ROOT / "tests", [*ROOMS[room].tests, *ROOMS[room].helpers, "conftest.py"])
        self.inputs = {"source": source, "tests": digest(used)}
        self.entries: dict[str, dict[str, str]] = {}
        self._path = LOGS / f"{room}.jsonl"
        lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.is_file() else []
        if lines:
            before, *entries = [json.loads(line) for line in lines]
            if before["source"] == source and (trusting or before == self.inputs):
                self.entries = {entry["mutant"]: entry for entry in entries}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        kept = [json.dumps(entry) for entry in (self.inputs, *self.entries.values())]
        self._path.write_text("\n".join([*kept, ""]), encoding="utf-8")

    def outcome(self, mutant: Mutant) -> str:
        """What became of a mutant; nothing if it was not tested yet."""
        return self.entries.get(mutant.name, {"outcome": ""})["outcome"]

    def doubt(self) -> None:
        """Forget the survivors, that they be tested again."""
        doubtful = ("survived", "suspect")
        self.entries = {
            name: entry for name, entry in self.entries.items() if entry["outcome"] not in doubtful
        }

    def add(self, run: Ended, outcome: str) -> None:
        """Record an outcome at once."""
        entry = {"mutant": run.mutant.name, "outcome": outcome, "by": run.by}
        self.entries[run.mutant.name] = entry
        with self._path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(entry) + "\n")

    def likely(self, mutant: Mutant, seconds: dict[str, float]) -> dict[str, float]:
        """How soon each test may be expected to kill a mutant: by its kills nearby and its time."""
        kills: Counter[str] = Counter()
        function, module = mutant.name.split(":")[0], mutant.module + " "
        for entry in self.entries.values():
            name = entry["mutant"]
            kills[entry["by"]] += 1 + 9 * name.startswith(module) + 90 * name.startswith(function)
        return {test: (1 + kills[test]) / (0.1 + spent) for test, spent in seconds.items()}


def explained() -> set[str]:
    """Names of the mutants that `mutation_survivors.md` explains: the items of its lists."""
    lines = EXPLAINED.read_text(encoding="utf-8").splitlines()
    return {line[3:].split("`")[0] for line in lines if line.startswith("- `")}


def main() -> int:
    """Run what the logs do not have, print the scores and the survivors."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--room", choices=ROOMS, help="this room alone")
    parser.add_argument("--jobs", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--only", default="", help="mutants whose name has this in it")
    parser.add_argument("--list", action="store_true", help="print the mutants and stop")
    parser.add_argument(
        "--survivors",
        action="store_true",
        help="test again those that survived; what older tests killed stays dead",
    )
    arguments = parser.parse_args()
    surprising = 0
    for room in [arguments.room] if arguments.room else ROOMS:
        modules = sorted((ROOT / "softwave_min" / room).glob("*.py"))
        every = [mutant for module in modules for mutant in mutants(module)]
        chosen = [mutant for mutant in every if arguments.only in mutant.name]
        if arguments.list:
            print("\n".join(mutant.name for mutant in chosen))
            continue
        log = Log(room, trusting=arguments.survivors)
        if arguments.survivors:
            log.doubt()
        run(chosen, log, room, arguments.jobs)
        surprising += report(chosen, log, room)
        if chosen == every:
            record(every, log, room)
    return 1 if surprising else 0


def run(chosen: list[Mutant], log: Log, room: str, jobs: int) -> None:
    """Test the mutants that the log does not know, several at a time."""
    if all(log.outcome(mutant) not in UNDECIDED for mutant in chosen):
        return
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    for name in PRELOADED:
        importlib.import_module(name)
    gc.freeze()
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        workshop = Workshop(Path(folder), jobs, room)
        workshop.unmutated(log)
        for profile, outcome in zip((QUICK, THOROUGH), UNDECIDED, strict=True):
            todo = [mutant for mutant in chosen if log.outcome(mutant) == outcome]
            print(f"{room}: {len(todo)} mutants, {profile} examples", flush=True)
            stage(workshop, todo, log, profile)


def stage(workshop: Workshop, todo: list[Mutant], log: Log, profile: str) -> None:
    """Let all of them meet the tests with few or all examples."""
    started = time.monotonic()
    for number, mutant in enumerate(todo, start=1):
        if not workshop.free:
            finish(workshop, log, profile)
        workshop.start(mutant, log, profile)
        if number % 20 == 0:
            minutes = (time.monotonic() - started) / 60
            print(f"{number} of {len(todo)} in {minutes:.0f} min", flush=True)
    while workshop.busy:
        finish(workshop, log, profile)


def finish(workshop: Workshop, log: Log, profile: str) -> None:
    """Wait for one run and record it."""
    ended = workshop.finish()
    suspect = ended.outcome == "survived" and profile == QUICK
    log.add(ended, "suspect" if suspect else ended.outcome)
    if ended.outcome == "survived":
        print(f"survived {profile}: line {ended.mutant.line}, {ended.mutant.name}", flush=True)


def report(chosen: list[Mutant], log: Log, room: str) -> int:
    """Print the score and the survivors without an explanation; their number."""
    score = Score.of(chosen, log)
    print(f"{room}: {score.killed + score.timeouts} of {score.mutants} killed")
    print(
        f"  {score.timeouts} of them by the time limit;"
        f" {score.explained} survivors explained, {len(score.surprising)} not"
    )
    for mutant in score.surprising:
        print(f"not explained: line {mutant.line}, `{mutant.name}`")
    return len(score.surprising)


@dataclass(frozen=True)
class Score:
    """What became of some mutants."""

    mutants: int
    killed: int
    """By a test that failed."""
    timeouts: int
    explained: int
    surprising: list[Mutant]
    """Survivors without an explanation."""

    @classmethod
    def of(cls, chosen: list[Mutant], log: Log) -> Score:
        """Count."""
        outcomes = Counter(log.outcome(mutant) for mutant in chosen)
        reasons = explained()
        survivors = [mutant for mutant in chosen if log.outcome(mutant) == "survived"]
        surprising = [mutant for mutant in survivors if mutant.name not in reasons]
        known = len(survivors) - len(surprising)
        return cls(len(chosen), outcomes["killed"], outcomes["timeout"], known, surprising)


def record(every: list[Mutant], log: Log, room: str) -> None:
    """Put the score of a whole room into its row of the table in `mutation_survivors.md`."""
    score = Score.of(every, log)
    cells = [score.mutants, score.killed, score.timeouts, score.explained, len(score.surprising)]
    row = " | ".join([f"| {room}", *map(str, cells), f"`{log.inputs['source']}` |"])
    text = EXPLAINED.read_text(encoding="utf-8")
    pattern = rf"^\| {room} \|.*$"
    EXPLAINED.write_text(re.sub(pattern, row, text, flags=re.MULTILINE), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
