"""What libraries import and our use of them does not need, put off until somebody needs it.

Both cases are a tenth of the time of a small problem from the shell. They are for processes of our
own only, commands and workers, which say so by :func:`own_the_process`; in a user's interpreter,
whose threads and libraries are not ours, everything is imported as its authors wrote it. Nothing
that a library can do is lost: what was put off is imported when it is first used. Where a library
is not as it is known here, its own imports run as they stand.
"""

from __future__ import annotations

import importlib
import sys
import types
from typing import Any

_ours = [False]


def own_the_process() -> None:
    """Say that this process runs a command or a worker of ours: imports may be put off."""
    _ours[0] = True


def load_cp_model() -> None:
    """Import OR-Tools' ``cp_model`` without pandas, which it needs for its methods that take or
    return series only.
    """
    name = "ortools.sat.python.cp_model"
    if not _ours[0] or name in sys.modules or "pandas" in sys.modules:
        return
    stand_in = types.ModuleType("pandas")
    stand_in.__dict__.update(Index=type("Index", (), {}), Series=type("Series", (), {}))
    sys.modules["pandas"] = stand_in
    try:
        cp_model: Any = importlib.import_module(name)
    except Exception:  # it needs more of pandas than the two names in its signatures
        sys.modules.pop(name, None)
        return
    finally:
        del sys.modules["pandas"]
    if getattr(cp_model, "pd", None) is stand_in:
        cp_model.pd = _Later("pandas")


class _Later(types.ModuleType):
    """A module that is imported when something of it is asked for."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(importlib.import_module(self.__name__), name)


def load_numba_arrays() -> None:
    """Import numba's array functions without ``scipy.linalg``, which they import only to see that
    it is there; linear algebra in a kernel imports it when that is compiled or run.
    """
    name = "numba.np.arraymath"
    if not _ours[0] or name in sys.modules:
        return
    linalg: Any = importlib.import_module("numba.np.linalg")
    check = getattr(linalg, "ensure_blas", None)
    if check is None or name in sys.modules:
        return
    linalg.ensure_blas = lambda: None
    try:
        arraymath: Any = importlib.import_module(name)
    finally:
        linalg.ensure_blas = check
    arraymath.ensure_blas = check
