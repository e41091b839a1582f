"""What all tests share."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import matplotlib as mpl
import pytest
from hypothesis import Phase, settings

from softwave_min.parameters import ParameterSet, parameter_set
from softwave_min.simulation import compile_engine

NOTEBOOK_LIMIT = 60.0
"""A reader waits no longer than this for a notebook, in s."""

mpl.use("agg")  # not by MPLBACKEND, which the notebooks' kernels would inherit
settings.register_profile(
    "reproducible", derandomize=True, database=None, deadline=None, max_examples=100
)
settings.register_profile(
    "mutation",
    settings.get_profile("reproducible"),
    max_examples=6,
    phases=[Phase.explicit, Phase.generate],  # a mutant is dead at its first failure
)
settings.load_profile("reproducible")

_spent: defaultdict[str, float] = defaultdict(float)


def pytest_sessionstart(session):
    """Compile what notebooks share before the first of them is timed."""
    timed = session.config.getoption("nbval", default=False)
    if not timed or hasattr(session.config, "workerinput"):
        return
    parameters = parameter_set()
    for reading in ("paper", "textbook"):
        compile_engine(replace(parameters, fluid=replace(parameters.fluid, morison=reading)))


@pytest.fixture(scope="session")
def nominal() -> ParameterSet:
    """The physical parameter set."""
    return parameter_set("physical")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Fail the cell at which a notebook exceeds the limit."""
    report = yield
    notebook, _, cell = item.nodeid.partition(".ipynb::")
    if cell and call.when == "call":
        _spent[notebook] += call.duration
        if report.passed and _spent[notebook] > NOTEBOOK_LIMIT:
            report.outcome = "failed"
            report.longrepr = f"{notebook}.ipynb takes longer than {NOTEBOOK_LIMIT:.0f} s"
    return report
