"""Ctrl-C is Ctrl-C, also where it comes as the cause of another exception."""

import pytest

from up_samp.system.imports import interrupt_behind


class Named:
    def __set_name__(self, owner, name):
        raise KeyboardInterrupt


def test_a_ctrl_c_while_a_class_is_made_is_found():
    """Up to Python 3.11 the error of ``__set_name__`` is a RuntimeError."""
    with pytest.raises((RuntimeError, KeyboardInterrupt)) as caught:
        type("Owner", (), {"name": Named()})
    assert type(interrupt_behind(caught.value)) is KeyboardInterrupt


def test_a_ctrl_c_that_a_cleaning_up_hides_is_found():
    def stopped():
        try:
            raise KeyboardInterrupt
        finally:
            raise ValueError("bug")

    with pytest.raises(ValueError, match="bug") as caught:
        stopped()
    assert interrupt_behind(caught.value) is not None


def test_other_errors_are_none():
    error = ValueError("bug")
    error.__cause__ = TypeError("cause")
    error.__cause__.__cause__ = error
    assert interrupt_behind(error) is None
    assert interrupt_behind(None) is None
