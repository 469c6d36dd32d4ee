"""Names short enough to be drawn."""

from __future__ import annotations

from typing import Any

from up_samp.plotting.sizes import SIZES


def with_short_names(plan: dict[str, Any]) -> dict[str, Any]:
    """Return a plan dictionary whose names can be drawn: longer ones are cut, and stay different.

    The plan itself is returned where all are short.
    """
    named = [*plan["objects"], *plan["activities"]]
    texts = [plan["problem"], plan["engine"], plan["status"]]
    texts += [entry["name"] for entry in named] + [o["type"] for o in plan["objects"]]
    longer = {t for t in texts if len(t) > SIZES.name}
    if not longer:
        return plan
    short: dict[str, str] = {}
    for i, text in enumerate(sorted(longer), 1):
        short[text] = f"{text[: SIZES.name - 6]}...{i}"
    keys = ("name", "type", "object", "activity")
    return {
        **plan,
        **{k: short.get(plan[k], plan[k]) for k in ("problem", "engine", "status")},
        **{
            part: [
                {k: short.get(v, v) if k in keys else v for k, v in entry.items()}
                for entry in plan[part]
            ]
            for part in ("objects", "activities", "motions", "changes")
        },
    }
