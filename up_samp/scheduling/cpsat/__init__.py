"""The ``cpsat`` scheduling engine: exact scheduling on OR-Tools CP-SAT."""

from up_samp.system.imports import load_cp_model

load_cp_model()

from up_samp.scheduling.cpsat.session import CpsatSession  # noqa: E402

__all__ = ["CpsatSession"]
