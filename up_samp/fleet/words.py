"""A site's own words for what its robots do, and where: for the exports of its plans."""

from __future__ import annotations

from typing import Any

from up_samp.fleet.records import FleetRecords
from up_samp.fleet.statements import Kind, Meaning, Written

ACTIONS = {Kind.PICKUP: "pick", Kind.DELIVERY: "drop", Kind.CHARGE: "startCharging"}
"""What VDA 5050 calls it, where the site says nothing else; the others are their kinds."""
_STOPS = {Kind.PICKUP: "pickup", Kind.DELIVERY: "delivery"}


def words_of(records: FleetRecords, written: Written) -> dict[str, Any]:
    """Return ``actions``, by activity its ``type`` and ``parameters`` (what it is ``for``), and
    ``places``, by name their pose in the world frame and the ``height`` of their floor (m).
    """
    heights = {name: floor.height for name, floor in records.floors.items()}
    return {
        "actions": {
            name: {"type": _action(records, meaning), "parameters": {"for": meaning.what}}
            for name, meaning in written.meanings.items()
        },
        "places": {
            name: {"pose": list(place.pose), "height": heights.get(place.floor, 0.0)}
            for name, place in records.places.items()
        },
    }


def _action(records: FleetRecords, meaning: Meaning) -> str:
    """Return what the site calls it: what its file says, or what is usual."""
    job = records.job_of.get(meaning.what)
    part = getattr(job, _STOPS.get(meaning.kind, ""), job)
    return getattr(part, "action", None) or ACTIONS.get(meaning.kind, meaning.kind.value)
