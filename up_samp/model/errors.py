"""Errors that users see. Each names the object, file or activity and what to do."""

from __future__ import annotations


class SampError(Exception):
    """Base of all errors raised on purpose by this package."""


class ProblemError(SampError, ValueError):
    """The problem is wrong or incomplete (a missing map, an unknown parameter, ...)."""


class UnsupportedError(SampError, NotImplementedError):
    """The problem is fine but uses a feature that is not supported; the feature is named."""


class EngineError(SampError, RuntimeError):
    """A wrapped engine crashed, answered wrongly, or overran its deadline."""
