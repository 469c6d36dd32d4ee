"""Which objects no constraint on a parameter alone forbids it to be."""

from __future__ import annotations

from collections.abc import Iterable

from up_samp.scheduling.cpsat.encode.forms import TRUE, Cmp, Form, Literal
from up_samp.scheduling.cpsat.encode.variables import Variables


def domains(forms: Iterable[Form], variables: Variables) -> dict[int, frozenset[int]]:
    """Return, of the parameters that are objects and of which some form speaks alone, the values
    that are left.

    Forms that hold where the parameter's activity is there are enough: nobody asks for the values
    of what is absent.

    Assumes: a form speaks of one parameter alone, and holds wherever its activity is there.
    """
    activities, bounds = variables.world.activities, variables.store.bounds
    presences = {
        var: TRUE if owner is None else activities[owner].present
        for var, tpe, owner in variables.parameters.values()
        if tpe.is_user_type()
    }
    told: dict[int, list[Form]] = {}
    for form in forms:
        var = _only(form)
        if var in presences and _literals(form) <= {~presences[var]}:
            told.setdefault(var, []).append(form)
    found = {}
    for var, some in told.items():
        low, high = bounds[var]
        found[var] = frozenset(v for v in range(low, high + 1) if all(_holds(f, v) for f in some))
    return found


def _only(form: Form) -> int:
    """Return the variable that a form compares, if it is one; else -1."""
    if form.__class__ is Cmp:
        return form.terms[0][0] if len(form.terms) == 1 else -1
    if form.__class__ is int:
        return -1
    found = -1
    for part in form[1:]:
        if part.__class__ is int:
            continue
        var = _only(part)
        if var < 0 or found not in (-1, var):
            return -1
        found = var
    return found


def _literals(form: Form) -> frozenset[Literal]:
    if form.__class__ is int:
        return frozenset((form,))
    if form.__class__ is Cmp:
        return frozenset(~need for need in form.needs)
    return frozenset[Literal]().union(*map(_literals, form[1:]))


def _holds(form: Form, value: int) -> bool:
    """Return whether a form holds if its variable has a value, and its activity is there."""
    if form.__class__ is int:
        return False
    if form.__class__ is Cmp:
        worth = form.const + form.terms[0][1] * value
        return {"<=": worth <= 0, "==": worth == 0, "!=": worth != 0}[form.op]
    parts = (_holds(part, value) for part in form[1:])
    return any(parts) if form[0] == "|" else all(parts)
