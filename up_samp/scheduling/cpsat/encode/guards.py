"""Nobody changes meanwhile what a condition reads."""

from __future__ import annotations

from up_samp.scheduling.cpsat.encode.states import States
from up_samp.scheduling.cpsat.encode.statevars import Read, StateVar


def guard(states: States, state: StateVar, read: Read) -> None:
    """Keep the effects of other activities out of the instants of ``read``."""
    store = states.store
    for write in state.writes:
        if read.owner is None or write.owner in (None, read.owner):
            continue
        before = store.literal(write.time.shift(1).le(read.lo))
        after = store.literal(read.hi.shift(1).le(write.time))
        store.clause([before, after, ~read.active, ~write.active])
