"""What the tests of the sea share."""

import pytest


@pytest.fixture(scope="session")
def parameters(nominal):
    """The sea's parameters."""
    return nominal.sea
