"""The ``cpsat`` scheduling engine: exact scheduling on OR-Tools CP-SAT."""

from up_samp.scheduling.cpsat.session import CpsatSession

__all__ = ["CpsatSession"]
