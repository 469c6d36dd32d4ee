"""Copy what stays the same from one Unified Planning problem into another."""

from __future__ import annotations

from unified_planning.model.mixins.timed_conds_effs import TimedCondsEffs
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.model.scheduling import SchedulingProblem
from unified_planning.model.scheduling.chronicle import Chronicle

from up_samp.model import ProblemError, UnsupportedError
from up_samp.upio.relaxation import every_effect
from up_samp.upio.rewrite import Rewriter
from up_samp.upio.spans import with_timings


def copy_state(
    problem: SchedulingMotionProblem, plain: SchedulingProblem, rewriter: Rewriter
) -> None:
    """Copy settings, objects, fluents and initial values."""
    plain.epsilon = problem.epsilon
    plain.discrete_time = problem.discrete_time
    plain.self_overlapping = problem.self_overlapping
    for obj in problem.all_objects:
        plain.add_object(rewriter.object(obj))
    defaults = problem.fluents_defaults
    for fluent in problem.fluents:
        value = defaults.get(fluent)
        plain.add_fluent(
            rewriter.fluent(fluent),
            default_initial_value=None if value is None else rewriter(value),
        )
    for fluent_exp, value in problem.explicit_initial_values.items():
        plain.set_initial_value(rewriter(fluent_exp), rewriter(value))


def check_fluents(problem: SchedulingMotionProblem, rewriter: Rewriter) -> None:
    """Raise where a fluent is used that the problem does not have, or that never has a value: no
    schedule would fit it.
    """
    known = set(problem.fluents)
    stray = sorted(f.name for f in rewriter.fluents if f not in known)
    if stray:
        raise ProblemError(
            f"the fluent '{stray[0]}' is used, but it is not in the problem (add it with "
            "problem.add_fluent, or add_resource)"
        )
    given = {f for f, value in problem.fluents_defaults.items() if value is not None}
    given |= {e.fluent() for e in problem.explicit_initial_values}
    given |= {e.fluent.fluent() for e in every_effect(problem)}
    empty = sorted(f.name for f in rewriter.fluents if f not in given)
    if empty:
        raise ProblemError(f"the fluent '{empty[0]}' has no initial value, and nothing sets it")


def copy_chronicle(source: Chronicle, target: Chronicle, rewriter: Rewriter) -> None:
    """Copy parameters, constraints, conditions and effects of an activity, or of the problem."""
    for name, parameter in source._parameters.items():
        target._parameters[name] = rewriter.parameter(parameter)
    for constraint, scope in source._constraints:
        target._constraints.append((rewriter(constraint), [rewriter(s) for s in scope]))
    _copy_timed(source, target, rewriter)


def _copy_timed(source: TimedCondsEffs, target: TimedCondsEffs, rewriter: Rewriter) -> None:
    for span, conditions in source.conditions.items():
        # one interval written in two ways is one interval
        same = target._conditions.setdefault(with_timings(span), [])
        same += [c for c in map(rewriter, conditions) if c not in same]
    for timing, effects in source.effects.items():
        for effect in effects:
            target._add_effect_instance(timing, rewriter.effect(effect))
    if source._simulated_effects:
        raise UnsupportedError("simulated effects are not supported in scheduling problems")
