"""The mutation run: what it changes, what it calls it, and that it finds what no test kills."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys

import pytest

from softwave_min.data import ROOT


@pytest.fixture
def mutation(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tests")
    import mutation

    return mutation


@pytest.mark.parametrize(
    ("operator", "before", "after"),
    [
        ("Swap", "ca.sin(a) + 1", ["ca.cos(a) + 1", "ca.sin(a) + 2"]),
        ("Swap", "a not in b", ["a in b"]),
        ("Swap", "a in b", ["a not in b"]),
        ("Drop", "a * b @ c / d", ["b @ c / d", "a @ c / d", "a * b / d", "a * b @ c"]),
        ("Drop", "-np.sqrt(a + b) ** 2", ["-np.sqrt(a + b)", "-(a + b) ** 2"]),
        ("Drop", "abs(a) + x.conj().T", ["a + x.conj().T", "abs(a) + x.T"]),
        ("Drop", "abs(a, out=b)", []),
    ],
)
def test_operators(mutation, operator, before, after):
    changes = []
    made = mutation.get_operator(f"ours/{operator}")()
    while changed := mutation.mutate_code(f"x = {before}\n", made, len(changes)):
        changes.append(ast.unparse(ast.parse(changed)))
    assert changes == [ast.unparse(ast.parse(f"x = {one}")) for one in after]


SOURCE = '''"""Add 1 to 1."""
class Triangle:
    def area(self, width: float, height: float) -> float:
        if width < 0:
            raise ValueError(f"{width - 1}: not that of a triangle")
        return 0.5 * width * height
'''
CONFTEST = """from hypothesis import settings
settings.register_profile("mutation", max_examples=2)
settings.register_profile("reproducible", max_examples=20)
"""
TEST = """from softwave_min.arm.triangle import Triangle
def test_area():
    assert Triangle().area(3, 4) == 6
"""


def test_a_survivor_must_be_explained_and_an_explanation_must_survive(tmp_path):
    texts = {
        "softwave_min/__init__.py": "",
        "softwave_min/arm/__init__.py": "",
        "softwave_min/arm/triangle.py": SOURCE,
        "tests/conftest.py": CONFTEST,
        "tests/arm/test_triangle.py": TEST,
        "data/nothing": "",
        "pyproject.toml": "",
        "environment.lock": "",
    }
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    folder = tmp_path / "tests"
    shutil.copy(ROOT / "tests" / "mutation.py", folder)
    # A triangle needs no more libraries than that.
    code = "import mutation as m; m.PRELOADED = ('hypothesis',); raise SystemExit(m.main())"

    def run(*names):
        lines = "".join(f"- `{name}`: nobody draws it so.\n" for name in names)
        (folder / "mutation_survivors.md").write_text(lines)
        command = [sys.executable, "-c", code, "--room", "arm", "--jobs", "1"]
        ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        return ended.returncode, ended.stdout.splitlines()

    survivor = "arm/triangle.py Triangle.area: 0 -> 1"
    killed = "arm/triangle.py Triangle.area: 0.5 * width -> width"
    status, lines = run(killed)
    assert status == 1
    assert lines[0].endswith(f"of 6: survived, {survivor}")
    score = "arm: 5 of 6 killed, 0 by the time limit"
    faults = [f"survives without an explanation: `{survivor}`", f"does not survive: `{killed}`"]
    assert lines[-3:] == [score, *faults]
    # The results are kept; only what is said of them changes.
    assert run(survivor) == (0, [score])
    assert (tmp_path / "softwave_min/arm/triangle.py").read_text() == SOURCE
