"""Motions between known configurations: one case of a task for each choice of its decisions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

from up_samp.model import ScheduledMotion
from up_samp.model.refinement import Given
from up_samp.model.snapshot import MotionTask, Snapshot, Term, TermKind
from up_samp.upio import Choice

Choices = Mapping[tuple[str, Term, bool], Choice]


@dataclass(frozen=True)
class MotionCase:
    """A motion task between known ``configurations`` (names): so it is under the decisions
    ``given`` (none: always).
    """

    task: MotionTask
    configurations: tuple[str, ...]
    given: Given = ()

    @property
    def activity(self) -> str:
        """The activity that makes the motion."""
        return self.task.activity


def cases_of(task: MotionTask, choices: Choices, most: int) -> list[MotionCase]:
    """Return all cases of a task; none where there are more than ``most``."""
    terms = [_choice(task, t, choices) for t in task.terms]
    domains = {c.variable: c.values for c in terms if c.variable is not None}
    if math.prod(len(values) for values in domains.values()) > most:
        return []
    found = []
    for values in itertools.product(*domains.values()):
        chosen = dict(zip(domains, values, strict=True))
        names = tuple(c.values[0] if c.variable is None else chosen[c.variable] for c in terms)
        found.append(MotionCase(task, names, tuple(sorted(chosen.items()))))
    return found


def _choice(task: MotionTask, term: Term, choices: Choices) -> Choice:
    if term.kind is TermKind.CONSTANT:
        return Choice(None, (term.name,))
    return choices[task.activity, term, False]


def case_of(snapshot: Snapshot, motion: ScheduledMotion) -> MotionCase:
    """Return the case that a scheduled motion is."""
    tasks = snapshot.tasks_of(motion.activity)
    task = next(t for t in tasks if t.index == motion.constraint)
    return MotionCase(task, motion.configurations, motion.given)
