"""How all kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numba

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile ``function`` without Python objects, once per machine (kept on disk by numba).

    Divisions follow IEEE 754 (no ZeroDivisionError), which halves the code to compile.
    """
    compiled: F = numba.njit(cache=True, error_model="numpy")(function)
    return compiled


def inner(function: F) -> F:
    """Compile ``function`` for use inside kernels only: no Python face, nothing on disk of its
    own.
    """
    compiled: F = numba.njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(
        function
    )
    return compiled
