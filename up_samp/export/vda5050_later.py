"""A plan as VDA 5050 orders of version 3.0 (see :mod:`.vda5050`)."""

from __future__ import annotations

from pathlib import Path

from up_samp.export import vda5050
from up_samp.io import PlanDict


def export(plan: PlanDict, folder: Path) -> list[Path]:
    """Write ``ROBOT/order-NNN.json`` for each robot and ``releases.json``."""
    return vda5050.export(plan, folder, vda5050.LATER)
