"""Who is there together: activities and bool variables that ``Iff`` makes one decision."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from unified_planning.model import FNode
from unified_planning.model.operators import OperatorKind as Op

from up_samp.scheduling.cpsat.normal.clauses import Constraint


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
