import pytest

from up_samp.motion.precompile import PARTS, precompile


@pytest.fixture(scope="session", autouse=True)
def compiled():
    """Compile all kernels first: time limits in these tests are meant for searching."""
    precompile(PARTS)
