"""When something begins or ends at the latest, or at the soonest, as one may write it."""

from unified_planning.model.scheduling import Activity
from unified_planning.shortcuts import GE, GT, LE, LT, Implies


def by_scope(problem, activity: Activity, limit):
    problem.add_constraint(limit, scope=[activity.present] if activity.optional else [])


def by_implication(problem, activity: Activity, limit):
    there = activity.present if activity.optional else True
    problem.add_constraint(Implies(there, limit))


def of_the_activity(problem, activity: Activity, limit):
    activity.add_constraint(limit)


WRITINGS = (by_scope, by_implication, of_the_activity)


def limits(point, units):
    """Return that a time is so many units at most, as one may write it."""
    return LE(point, units), LT(point, units + 1), GE(units, point), LE(point - 2, units - 2)


def releases(point, units):
    """Return that a time is so many units at least, as one may write it."""
    return GE(point, units), GT(point, units - 1), LE(units, point), GE(point + 2, units + 2)
