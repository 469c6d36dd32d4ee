import pytest

from up_samp.model import MotionModel
from up_samp.motion.compile import precompile


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compile all kernels first: time limits in these tests are meant for searching."""
    precompile(MotionModel)
