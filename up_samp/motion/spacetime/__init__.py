"""Several robots at once, in space and time."""

from up_samp.motion.spacetime.groups import coordinate

__all__ = ["coordinate"]
