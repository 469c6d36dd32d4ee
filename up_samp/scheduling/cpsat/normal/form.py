"""The normal form of a problem: the list of steps from what is written to what is recognised.

Each step says the same in one way, so a model may be built from any of them; what recognition finds
in the form only adds what follows anyway, or replaces what is equivalent.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from unified_planning.model import Effect, FNode, Timing
from unified_planning.model.operators import OperatorKind as Op
from unified_planning.model.scheduling import Activity
from unified_planning.model.timing import TimepointKind

from up_samp.scheduling.cpsat.encode.durations import constant_bounds
from up_samp.scheduling.cpsat.normal.clauses import Constraint, split
from up_samp.scheduling.cpsat.normal.precedences import FollowUp, PrecedenceReader, Precondition
from up_samp.scheduling.cpsat.problem import Additions

TimedEffect = tuple[Timing, Effect, "Activity | None"]


def anchor(effects: Iterable[TimedEffect]) -> list[TimedEffect]:
    """Return ``effects`` with ``start + k`` told as ``end - (length - k)`` where that is nearer."""
    return [(_anchored(timing, owner), effect, owner) for timing, effect, owner in effects]


def _anchored(timing: Timing, owner: Activity | None) -> Timing:
    point = timing.timepoint
    if owner is None or point.container != owner.name or point.kind is not TimepointKind.START:
        return timing
    lower, upper = constant_bounds(owner.duration)
    if lower is None or lower != upper or 2 * timing.delay <= lower:
        return timing
    return Timing(timing.delay - lower, owner.end)


# ------------------ Who is there together


@dataclass(frozen=True)
class Presences:
    """Names of activities and bool variables -> the first name of those decided together."""

    leader: dict[str, str]

    def of(self, name: str) -> str:
        """Return who decides about ``name``."""
        return self.leader.get(name, name)

    def classes(self) -> dict[str, list[str]]:
        """Return leader -> all names that it decides about, for more than one, in order."""
        found: dict[str, list[str]] = {}
        for name, leader in self.leader.items():
            found.setdefault(leader, []).append(name)
        return found


def decided(node: FNode) -> str | None:
    """Return the name if ``node`` is the presence of an activity or a bool variable."""
    if node.node_type is Op.PRESENT_EXP:
        return str(node.presence().container)
    if node.node_type is Op.PARAM_EXP and node.type.is_bool_type():
        return str(node.parameter().name)
    return None


def find_presences(
    constraints: Iterable[Constraint], optional: list[str], variables: list[str]
) -> Presences:
    """Return what unconditional ``Iff(a, b)`` between presences and bool variables decide together.

    Assumes: ``Iff`` is said without a condition, of presences and bool variables of the problem
    itself.

    :param optional: names of the optional activities, in order.
    :param variables: names of the problem's own bool variables.
    """
    parent = {name: name for name in [*optional, *variables]}

    def root(name: str) -> str:
        while parent[name] != name:
            parent[name] = parent[parent[name]]
            name = parent[name]
        return name

    rank = {name: i for i, name in enumerate(parent)}
    for node, scope, _ in constraints:
        if scope or node.node_type not in (Op.IFF, Op.EQUALS) or len(node.args) != 2:
            continue
        one, other = decided(node.arg(0)), decided(node.arg(1))
        if one in parent and other in parent and one is not None and other is not None:
            a, b = sorted((root(one), root(other)), key=rank.__getitem__)
            parent[b] = a
    together: dict[str, list[str]] = {}
    for name in parent:
        together.setdefault(root(name), []).append(name)
    return Presences({n: r for r, names in together.items() if len(names) > 1 for n in names})


# ------------------ The normal form of a problem


@dataclass(frozen=True)
class NormalForm:
    """A problem's parts in one style, who is there together, and what is said with precedences.

    ``preconditions`` are not among the constraints of ``parts`` any more, follow-ups are.
    """

    parts: Additions
    presences: Presences
    preconditions: list[Precondition] = field(default_factory=list)
    follow_ups: list[FollowUp] = field(default_factory=list)


def normal_form(parts: Additions) -> NormalForm:
    """Return the normal form of all parts of a problem (not of what is appended later)."""
    preconditions, follow_ups, others = PrecedenceReader().read(parts.constraints)
    parts = replace(parts, constraints=split(others))
    parts = replace(parts, effects=anchor(parts.effects))
    presences = find_presences(
        parts.constraints,
        [a.name for a in parts.activities if a.optional],
        [v.name for v in parts.variables if v.type.is_bool_type()],
    )
    return NormalForm(parts, presences, preconditions, follow_ups)
