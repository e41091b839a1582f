r"""The study, step by step.

1. *Screening* by Morris's elementary effects, over all open parameters in their plausible
   ranges (``data/studies/plausible_ranges.toml``) and the random sea.
2. A *design* that fills the ranges of the values that matter most; the others keep the value
   of the base set. An emulator, a polynomial, is fitted to each headline number, and
   variance-based indices are computed on it.
3. *Draws* not seen before, of all values, which the emulators have to predict.

Why emulators: sampled directly, intervals of a tenth for a few indices take thousands of sets
at some seconds each. Far fewer determine a smooth function, and resamples show how well.

``data/studies/sensitivity.toml`` fixes all of it beforehand. Each set that is judged is a
run of the store: what is interrupted goes on where it was.
"""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from softwave_min.parameters import parameter_set
from softwave_min.runs.executor import Executor
from softwave_min.runs.experiment import Experiment, RunArrays, Tables
from softwave_min.runs.store import Store
from softwave_min.runs.sweep import compute
from softwave_min.studies.sensitivity.samples import SEA, Sample, Study, design, draws, screening
from softwave_min.studies.sensitivity.tables import (
    important,
    index_table,
    prediction_table,
    screening_table,
)

NAME = "sensitivity"
"""Folder of its results."""


def investigate(store: Store, workers: Executor, settings: Study) -> list[str]:
    """Go through the steps and write their tables; the fields of the important values.

    Tables ``screening``, ``indices`` and ``prediction``, and the evaluations that each was
    made of.
    """
    screened = screening(settings)
    _evaluate(screened, store, workers, settings)
    chosen = important(store.read_table("screening"), settings)
    everything = [*screened, *design(settings, chosen), *draws(settings, chosen)]
    _evaluate(everything, store, workers, settings)
    return chosen


def _evaluate(samples: Sequence[Sample], store: Store, workers: Executor, settings: Study) -> None:
    """Judge the sets that are missing, and write the tables of all."""
    runs = [sample.run(settings) for sample in samples]
    step = Experiment(
        name=store.experiment,
        title="What the headline numbers hang on",
        claims=(),
        runs=lambda _: runs,
        tabulate=lambda _, arrays: _tables(samples, settings, arrays),
    )
    compute(step, parameter_set(settings.base), store, workers)


def _tables(samples: Sequence[Sample], settings: Study, arrays: RunArrays) -> Tables:
    tables = {
        f"{step}_evaluations": _evaluations(chosen, arrays)
        for step in ("screening", "design", "draw")
        if (chosen := [one for one in samples if one.name.startswith(f"{step}-")])
    }
    tables["screening"] = screening_table(tables["screening_evaluations"], settings)
    if "design_evaluations" in tables:
        designed = tables["design_evaluations"]
        tables["indices"] = index_table(designed, settings)
        tables["prediction"] = prediction_table(
            tables["draw_evaluations"], designed, tables["screening_evaluations"], settings
        )
    return tables


def _evaluations(samples: Sequence[Sample], arrays: RunArrays) -> pd.DataFrame:
    """The sets and their headline numbers, which a set that cannot run lacks."""
    rows = []
    for sample in samples:
        found = arrays[sample.name]
        numbers = {} if "failure" in found else {name: float(found[name]) for name in found}
        drawn = {"drawn": sample.drawn} if sample.drawn else {}
        rows.append({"sample": sample.name, **drawn, SEA: sample.sea, **sample.values, **numbers})
    return pd.DataFrame(rows)
