"""Several robots at once, in space and time."""

from up_samp.motion.fleet.coordination import coordinate
from up_samp.motion.fleet.one_robot import earliest_arrival
from up_samp.motion.fleet.profile import OffsetProfile, offset_profile

__all__ = ["OffsetProfile", "coordinate", "earliest_arrival", "offset_profile"]
