"""Scheduling And Motion Planning (SAMP) as a plugin of Unified Planning.

Importing the package registers its engines in UP's global environment by name; what they need is
imported when it is used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from up_samp.engines.registration import register, register_globally

if TYPE_CHECKING:
    from up_samp.fleet import Fleet
    from up_samp.model import SampError, Trajectory
    from up_samp.upio.plan import trajectories

__version__ = "0.1.0"

_HOMES = {
    "Fleet": "up_samp.fleet",
    "SampError": "up_samp.model",
    "Trajectory": "up_samp.model",
    "trajectories": "up_samp.upio.plan",
}

register_globally()

__all__ = ["Fleet", "SampError", "Trajectory", "__version__", "register", "trajectories"]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'up_samp' has no attribute '{name}'")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
