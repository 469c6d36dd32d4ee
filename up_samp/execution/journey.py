"""The legs of a run with re-planning as one run, on the clock of the first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from up_samp.execution.simulate import Simulation
from up_samp.io.plan_dict import PlanDict


def joined(legs: Sequence[Simulation], since: Sequence[float]) -> Simulation:
    """Return one run; ``since`` are the legs' starts (s). An activity that goes on in a later leg
    is there once for each: ``NAME``, ``NAME (resumed)``.
    """
    first, last = legs[0], legs[-1]
    makespan = since[-1] + last.makespan
    lasted = sum(leg.lasted for leg in legs)
    waited = sum(leg.waiting * leg.lasted for leg in legs)
    return replace(
        last,
        seed=first.seed,
        planned=first.planned,
        makespan=makespan,
        waiting=waited / lasted if lasted else 0.0,
        lasted=lasted,
        overruns=sum(leg.overruns for leg in legs),
        reorders=sum(leg.reorders for leg in legs),
        contacts=tuple(
            replace(c, time=c.time + begin)
            for leg, begin in zip(legs, since, strict=True)
            for c in leg.contacts
        ),
        broken=tuple(text for leg in legs for text in leg.broken),
        missed=tuple(text for leg in legs for text in leg.missed),
        record=_record(legs, since, makespan),
        waits=tuple(
            (who, low + begin, high + begin, whom)
            for leg, begin in zip(legs, since, strict=True)
            for who, low, high, whom in leg.waits
        ),
        replans=len(legs) - 1,
    )


def _record(legs: Sequence[Simulation], since: Sequence[float], makespan: float) -> PlanDict:
    """Return the legs' records one after the other."""
    unit = float(legs[0].record["seconds_per_unit"])
    parts: dict[str, list[Any]] = {}
    taken: set[str] = set()
    for leg, begin in zip(legs, since, strict=True):
        names = {a["name"]: _fresh(a["name"], taken) for a in leg.record["activities"]}
        taken.update(names.values())
        for key, entries in _later(leg.record, begin, unit).items():
            parts.setdefault(key, []).extend(_renamed(entries, names))
    if not parts["rides"]:
        del parts["rides"]
    parts["motions"].sort(key=lambda m: m["samples"][0][0])
    return {**legs[0].record, **parts, "makespan": round(makespan / unit, 6)}


def _fresh(name: str, taken: set[str]) -> str:
    count, found = 1, name
    while found in taken:
        found = f"{name} (resumed)" if count == 1 else f"{name} (resumed {count})"
        count += 1
    return found


def _later(record: PlanDict, begin: float, unit: float) -> dict[str, list[dict[str, Any]]]:
    """Return what happened, ``begin`` s later."""
    return {
        "activities": [
            {
                **a,
                "start": round(a["start"] + begin / unit, 9),
                "end": round(a["end"] + begin / unit, 9),
            }
            for a in record["activities"]
        ],
        "motions": [
            {**m, "samples": [[round(r[0] + begin, 6), *r[1:]] for r in m["samples"]]}
            for m in record["motions"]
        ],
        "changes": [{**c, "time": round(c["time"] + begin, 6)} for c in record["changes"]],
        "waits": [
            {**w, "since": round(w["since"] + begin, 6), "until": round(w["until"] + begin, 6)}
            for w in record["waits"]
        ],
        "rides": list(record.get("rides", ())),
    }


def _renamed(
    entries: Sequence[Mapping[str, Any]], names: Mapping[str, str]
) -> list[dict[str, Any]]:
    """Return entries with their activities' names in the whole record."""
    found = []
    for entry in entries:
        changed = dict(entry)
        for key in ("name", "activity"):
            if key in entry:
                changed[key] = names[entry[key]]
        found.append(changed)
    return found
