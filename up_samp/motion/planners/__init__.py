"""Planners for one body among resting obstacles (see :mod:`up_samp.motion.protocol`)."""
