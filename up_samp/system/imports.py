"""Imports put off: what libraries import and our use of them does not need, until somebody does.

All cases are a tenth of the time of a small problem from the shell. They are for processes of our
own only, commands and workers, which say so by :func:`own_the_process`; in a user's interpreter,
whose threads and libraries are not ours, everything is imported as its authors wrote it. Nothing
that a library can do is lost: what was put off is imported when it is first used. Where a library
is not as it is known here, its own imports run as they stand.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import types
from collections.abc import Iterator, Sequence
from typing import Any


@contextlib.contextmanager
def extra(what: str, name: str, packages: str) -> Iterator[None]:
    """Import what the extra ``name`` brings; where it is missing, say so of ``what`` needs it.

    :raises UnsupportedError: that names the missing module and the ``packages`` to install.
    """
    try:
        yield
    except ImportError as error:
        from up_samp.model.errors import UnsupportedError

        missing = f"({error.name} is missing): pip install {packages}"
        raise UnsupportedError(f"{what} needs the extra [{name}] {missing}") from error


_ours = [False]


def own_the_process() -> None:
    """Say that this process runs a command or a worker of ours: imports may be put off.

    OpenBLAS gets one thread, unless somebody has decided otherwise: our matrices are small, and
    where memory is short its threads end the process, or hang it, before Python can say so.
    """
    _ours[0] = True
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def load_cp_model() -> None:
    """Import OR-Tools' ``cp_model`` without pandas, which it needs for its methods that take or
    return series only.
    """
    _import_without("pandas", ("Index", "Series"), "ortools.sat.python.cp_model")


def load_unified_planning() -> None:
    """Import Unified Planning's models, plans and engines without networkx, which they need for
    graphs of tasks and of partial orders only.
    """
    _import_without("networkx", ("DiGraph",), "unified_planning.engines")


def _import_without(library: str, names: Sequence[str], module: str) -> None:
    """Import ``module`` and all that it needs, but not ``library``, of which only the classes
    ``names`` are looked at meanwhile (in signatures).
    """
    if not _ours[0] or module in sys.modules or library in sys.modules:
        return
    stand_in = types.ModuleType(library)
    stand_in.__dict__.update({name: type(name, (), {}) for name in names})
    before = set(sys.modules)
    sys.modules[library] = stand_in
    try:
        importlib.import_module(module)
    except Exception:  # something needs more of the library than these classes
        for name in set(sys.modules) - before:
            del sys.modules[name]
        return
    finally:
        sys.modules.pop(library, None)
    for name in set(sys.modules) - before:
        space = vars(sys.modules[name])
        for key in [k for k, value in space.items() if value is stand_in]:
            space[key] = _Later(library)


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


# ------------------ Ctrl-C behind another exception: libraries wrap what interrupts them


def interrupt_behind(error: BaseException | None) -> KeyboardInterrupt | None:
    """Return the Ctrl-C that an exception comes from, None if it comes from something else.

    Where a signal arrives while a module is loaded, Python (until 3.11, in ``__set_name__``) and
    libraries raise an error of their own from it.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return error
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return None
