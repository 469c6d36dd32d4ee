"""Kernels are compiled first here, too: time limits are meant for searching."""

from tests.search.conftest import compiled as compiled
