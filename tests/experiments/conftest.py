"""What the tests of the experiments share."""

from __future__ import annotations

import matplotlib.pyplot as plt
import pytest

from softwave_min.figures.style import apply


@pytest.fixture(autouse=True)
def styled():
    """Draw in the one style, and close what was drawn."""
    apply()
    yield
    plt.close("all")
