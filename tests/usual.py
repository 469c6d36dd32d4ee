"""Cases of a test that are run each time, and those that only ``--long`` runs."""

import pytest


def usually(*kept, of):
    """Return the cases ``of`` a test for ``parametrize``: all but those ``kept`` are marked long.

    A tuple has a value for each of several arguments; what is marked already stays as it is.
    """
    cases = list(of)
    assert all(case in cases for case in kept), f"{kept} are not all among {cases}"
    return [case if case in kept or hasattr(case, "marks") else _long(case) for case in cases]


def _long(case):
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.long)
