"""Several robots at once, in space and time."""

from up_samp.motion.spacetime.groups import coordinate
from up_samp.motion.spacetime.profile import OffsetProfile, offset_profile
from up_samp.motion.spacetime.single import earliest_arrival

__all__ = ["OffsetProfile", "coordinate", "earliest_arrival", "offset_profile"]
