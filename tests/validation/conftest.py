"""What several tests of the validator start from."""

import pytest

from tests.validation.validation_kit import HOME, World


@pytest.fixture
def world(tmp_path):
    """One car that drives a winding way with a cusp, one that is parked."""
    w = World(tmp_path)
    w.object("r1", HOME)
    w.object("r2", (30.0, 4.0, 0.0))
    return w
