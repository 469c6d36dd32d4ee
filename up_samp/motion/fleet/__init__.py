"""Several robots at once, in space and time."""

from up_samp.motion.fleet.coordination import coordinate

__all__ = ["coordinate"]
