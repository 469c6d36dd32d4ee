import pytest

from up_samp.model import MotionModel
from up_samp.motion import legs
from up_samp.motion.compile import precompile


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compile all kernels first: time limits in these tests are meant for searching."""
    precompile(MotionModel)


@pytest.fixture
def no_second_opinions(monkeypatch):
    """Spare the time that planners are given for what another one has not found."""
    monkeypatch.setattr(legs, "SECOND_OPINION", 0.2)
