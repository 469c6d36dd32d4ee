"""Shares of jobs by simple guesses."""

import random

from up_samp.model import Deadline
from up_samp.search.fleet.assignment import assign
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.travel_times import TravelTimeModel
from up_samp.tuning import Tuning


def along_the_axes(body, a, b):
    """Return a guess (s) of a drive between two poses in the plane, with a turn."""
    limits = body.kinematics
    length = abs(a[0] - b[0]) + abs(a[1] - b[1])
    return length / limits.v_max + limits.v_max / limits.a_max + 2.0


def assigned(jobs, snapshot, lasts=along_the_axes, seed=0, **tuning):
    evaluator = AssignmentEvaluator(TravelTimeModel(snapshot, lasts), jobs)
    return assign(evaluator, Deadline.never(), random.Random(seed), Tuning(**tuning))
