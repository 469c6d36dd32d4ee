"""Ctrl-C behind another exception: libraries wrap what interrupts them."""

from __future__ import annotations


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
