"""The style of the figures."""

from __future__ import annotations

import os
import subprocess
import sys

CODE = """
import sys
from softwave_min.figures import style
import matplotlib.pyplot as plt
style.apply()
for _ in range(2):
    plt.figure()
    plt.fill_between([0, 1], [1, 0], hatch="/")
    plt.savefig(sys.stdout, format="svg")
"""


def test_a_figure_that_others_write_is_the_same_on_any_day():
    """As a notebook's inline figures, which know nothing of the style's own ``svg``."""
    plain = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
    drawn = subprocess.run(
        [sys.executable, "-c", CODE], env=plain, capture_output=True, text=True, check=True
    ).stdout
    half = len(drawn) // 2
    assert drawn[:half] == drawn[half:]
    assert "<dc:date>1970-01-01" in drawn
