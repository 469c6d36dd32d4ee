"""Ways past the places where others may stand.

A robot's best way leads through places where others load or wait. On it, it has to wait for them;
on a way past all such places it meets only those that drive. Such ways depend on nobody's times, so
they are looked for once, before anything is decided. (On a *well-formed* floor there is one for
each motion; Čáp, Novák, Kleiner and Selecký, IEEE T-ASE 2015.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from up_samp.model import Body, Configuration, Deadline, Placed
from up_samp.motion.fleet.detours import crowds
from up_samp.motion.fleet.paths import Path
from up_samp.motion.fleet.workspace import Workspace

Stand = tuple[Body, Configuration]
"""Who may stand where."""


def ways_past(
    workspace: Workspace,
    poses: tuple[Configuration, ...],
    best: Path,
    stands: Sequence[Stand],
    deadline: Deadline,
    *,
    tries: int,
) -> Iterator[Path]:
    """Yield ways through poses, as the ``best`` path drives through them: past those of some stands
    that it runs into, then past those, too, that this way runs into, and so on.

    Stands near its ends are left out: there it has to be.

    :param tries: so many ways are looked for.
    """
    others = [s for s in stands if not crowds(workspace, best, s[1], workspace.resting(*s))]
    path, avoided = best, dict[Stand, Placed]()
    for _ in range(tries):
        met = [s for s in others if len(workspace.conflicts(path, workspace.resting(*s)))]
        if not met or deadline.expired():
            return
        avoided.update((s, Placed(f"stand {len(avoided) + n}", *s)) for n, s in enumerate(met))
        found = workspace.detour(path.body, poses, (), list(avoided.values()), deadline)
        if found is None:
            return
        yield found
        path = found
