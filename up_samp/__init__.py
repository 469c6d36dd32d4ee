"""Scheduling And Motion Planning (SAMP) as a plugin of Unified Planning.

Importing the package registers its engines in UP's global environment.
"""

from up_samp.engines.registration import register
from up_samp.model import SampError, Trajectory
from up_samp.upio.plan import trajectories

__version__ = "0.1.0"

register()

__all__ = ["SampError", "Trajectory", "__version__", "register", "trajectories"]
