"""Motions: planners, bounds, proofs of impossibility, timing and a cache behind one service."""

from up_samp.motion.protocol import Leg, LegQuery, MotionCache, MotionPlanner
from up_samp.motion.service import MotionService

__all__ = ["Leg", "LegQuery", "MotionCache", "MotionPlanner", "MotionService"]
