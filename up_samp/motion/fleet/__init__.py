"""Several robots at once, in space and time."""

from up_samp.motion.fleet.coordination import coordinate
from up_samp.motion.fleet.one_robot import earliest_arrival

__all__ = ["coordinate", "earliest_arrival"]
