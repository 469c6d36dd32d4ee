"""Which activities come before which others in every schedule."""

from __future__ import annotations

from collections.abc import Iterable

from up_samp.scheduling.cpsat.encode.forms import Cmp, Form


class PrecedenceClosure:
    """What follows from unconditional differences between the times of activities.

    Assumes: what is stated without condition holds in every schedule, of the times of what is
    absent, too.

    :param forms: all that is stated; only ``u + k <= v`` (k > 0), said without condition, counts.
    """

    def __init__(self, forms: Iterable[Form]) -> None:
        self._after: dict[int, set[int]] = {}
        for form in forms:
            if form.__class__ is Cmp and not form.needs and form.op == "<=":
                coefficients = dict(form.terms)
                if sorted(coefficients.values()) == [-1, 1] and form.const > 0:
                    (first,) = (v for v, c in form.terms if c == 1)
                    (then,) = (v for v, c in form.terms if c == -1)
                    self._after.setdefault(first, set()).add(then)
        self._known: dict[int, set[int]] = {}

    def before(self, first: int, then: int) -> bool:
        """Return whether variable ``first`` is less than ``then`` in every schedule."""
        known = self._known.get(first)
        if known is None:
            known = self._known[first] = set()
            agenda = [first]
            while agenda:
                new = self._after.get(agenda.pop(), set()) - known
                known |= new
                agenda.extend(new)
        return then in known
