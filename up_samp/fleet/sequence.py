"""Which orders and tasks come before which others: as they say, or by what they are about."""

from __future__ import annotations

from up_samp.fleet.records import FleetRecords, Order, Task


def earlier_than(records: FleetRecords, job: Order | Task) -> tuple[str, ...]:
    """Return what has ended before a job begins: what it names, who has put down the load that it
    takes on, the task whose part it fetches, and who brings parts to it.
    """
    found = list(job.after)
    if isinstance(job, Order):
        if isinstance(job.attached, str):
            found.append(job.attached)
        if job.pickup.task is not None:
            found.append(job.pickup.task)
    else:
        found += [o.id for o in records.bringers.get(job.id, ())]
    return tuple(dict.fromkeys(found))
