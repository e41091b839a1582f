"""Numbers over random seas: medians with 90 % intervals, and rank correlations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from pandas.core.groupby.generic import SeriesGroupBy

INTERVAL = (0.05, 0.5, 0.95)
"""Quantiles over the random seas: a 90 % interval and its median."""
NAMES = ("low", "median", "high")


def over_seas(values: ArrayLike) -> tuple[float, float, float]:
    """5 % quantile, median and 95 % quantile of a number over the random seas."""
    low, median, high = (float(one) for one in np.quantile(np.asarray(values, float), INTERVAL))
    return low, median, high


def interval(values: ArrayLike) -> dict[str, float]:
    """``low``, ``median`` and ``high`` of a number, as `over_seas` has them."""
    return dict(zip(NAMES, over_seas(values), strict=True))


def intervals_of(groups: SeriesGroupBy[Any, Any]) -> pd.DataFrame:
    """``low``, ``median`` and ``high`` of each group, as `over_seas` has them."""
    return pd.DataFrame(
        {name: groups.quantile(level) for name, level in zip(NAMES, INTERVAL, strict=True)}
    )


def rank_correlation(first: pd.Series, second: pd.Series) -> float:
    """Spearman's coefficient, between -1 and 1; NaN where one of the two is constant."""
    return float(first.rank().corr(second.rank()))
