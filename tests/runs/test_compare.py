"""How two tables are told apart."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from softwave_min.runs.compare import compare_tables, compare_texts, tolerances_of
from softwave_min.runs.experiment import Tolerance


def table(**columns):
    return pd.DataFrame({"case": ["W1", "W2", "W3"], **columns})


@pytest.mark.parametrize(
    ("ours", "committed", "tolerance", "agree"),
    [
        ([1.5, 2.5, 3.5], [1.5, 2.5, 3.5], None, True),
        ([1.5, 2.5, 3.50034], [1.5, 2.5, 3.5], None, True),  # within 1e-4 relative
        ([1.5, 2.5, 3.50036], [1.5, 2.5, 3.5], None, False),
        ([1.5, 2.5, 0.9e-6], [1.5, 2.5, 0.0], None, True),  # within 1e-6 absolute
        ([1.5, 2.5, 1.1e-6], [1.5, 2.5, 0.0], None, False),
        ([1.5, np.nan, 3.5], [1.5, np.nan, 3.5], None, True),
        ([1.5, np.nan, 3.5], [1.5, 2.5, 3.5], None, False),
        ([1.5, 2.5, 3.5], [1.5, np.nan, 3.5], Tolerance(1.0, 1.0), False),
        ([1.5, np.inf, 3.5], [1.5, np.inf, 3.5], None, True),
        ([1.5, np.inf, 3.5], [1.5, -np.inf, 3.5], Tolerance(1.0, 1.0), False),
        ([1.5, 2.5, 3.5], [1.5, np.inf, 3.5], Tolerance(1.0, 1.0), False),
        ([1.0, 2.0, 3.00001], [1, 2, 3], None, True),  # all whole by chance, on one side
        ([100000, 2, 3], [100001, 2, 3], None, False),
        ([10, 2, 3], [12, 2, 3], Tolerance(0.0, 2.0), True),
        ([10, 2, 3], [13, 2, 3], Tolerance(0.0, 2.0), False),
        (["a", "b", None], ["a", "b", None], None, True),
        (["a", "b", "c"], ["a", "b", "d"], None, False),
        ([True, False, True], [True, False, False], Tolerance(2.0, 2.0), False),
    ],
)
def test_cells_agree_within_their_columns_tolerance(ours, committed, tolerance, agree):
    tolerances = {"value": tolerance} if tolerance else {}
    found = compare_tables(table(value=ours), table(value=committed), tolerances)
    assert found.agrees is agree
    assert len(found.differences) == (not agree)


def test_a_difference_is_told_by_its_place_and_size():
    ours, committed = [1.0, 2.0, 3.5], [1.0, 2.0, 3.0]
    found = compare_tables(table(value=ours, same=0.5), table(value=committed, same=0.5))
    assert found.text == "3 rows DIFFER; largest relative difference 1.7e-01 in value"
    assert found.differences == (
        "value: 1 of 3 rows; row 3 (case W3): 3.5 here, 3.0 committed, "
        "off by 5.0e-01 (1.7e-01 relative); allowed 1e-06 or 0.0001 relative",
    )


@pytest.mark.parametrize(
    ("ours", "said"),
    [
        (table(value=1.0).head(2), "2 rows, 3 committed"),
        (table(value=1.0, more=2.0), "new column more"),
        (table(), "no column value"),
        (table(value=1.0)[["value", "case"]], "columns in another order"),
    ],
)
def test_tables_of_another_shape_differ(ours, said):
    found = compare_tables(ours, table(value=1.0))
    assert not found.agrees
    assert said in found.text


def test_a_table_that_is_new_has_nothing_to_differ_from():
    assert compare_texts("value\n1.0\n", None, {}).agrees


def test_a_tolerance_is_for_all_tables_unless_it_names_one():
    tolerances = {"rmse": Tolerance(1.0), "cells.rmse": Tolerance(2.0), "cells.lag": Tolerance(3.0)}
    assert tolerances_of(tolerances, "cells") == {"rmse": Tolerance(2.0), "lag": Tolerance(3.0)}
    assert tolerances_of(tolerances, "joints") == {"rmse": Tolerance(1.0)}
