"""How all kernels are compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

from up_samp.geometry.kernel_cache import KernelCache

F = TypeVar("F", bound=Callable[..., object])


def kernel(function: F) -> F:
    """Compile ``function`` without Python objects, once per machine (kept on disk, see
    :mod:`up_samp.geometry.kernel_cache`).

    Divisions follow IEEE 754 (no ZeroDivisionError), which halves the code to compile.
    """
    compiled = numba.njit(error_model="numpy", no_cfunc_wrapper=True)(function)
    if hasattr(compiled, "_cache"):  # not where numba is switched off
        compiled._cache = KernelCache(function)
    return cast(F, compiled)


def inner(function: F) -> F:
    """Compile ``function`` for use inside kernels only: no Python face, nothing on disk of its
    own.
    """
    compiled: F = numba.njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(
        function
    )
    return compiled
