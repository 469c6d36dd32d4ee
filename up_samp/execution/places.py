"""Where everybody stands when a new clock starts: at rest, or where they can stop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from unified_planning.model.motion import SchedulingMotionProblem

from up_samp.execution.graph import At, Event
from up_samp.execution.lives import Drive
from up_samp.execution.state import Phase, State
from up_samp.io.floors import map_number, side_by_side
from up_samp.io.plan_dict import PlanDict
from up_samp.model import Configuration
from up_samp.model.frames import Frame

Place = tuple[Configuration, Any]
"""A pose, and the type of configurations that it is one of (which says on which map)."""


class Places:
    """Poses by what has happened so far."""

    def __init__(
        self,
        problem: SchedulingMotionProblem,
        plan: PlanDict,
        state: State,
        drives: Mapping[tuple[str, str], Drive],
    ):
        self.plan, self.state, self.drives = plan, state, drives
        self.frames = side_by_side(plan)[1]
        self.map_of = {(m["activity"], m["object"]): map_number(m) for m in plan["motions"]}
        self.first: dict[str, Place] = {}
        for movable, place in problem.initial_configuration:
            pose = tuple(float(v) for v in place.object().configuration)
            self.first[movable.object().name] = pose, place.object().type
        self.goals: dict[tuple[str, str], Any] = {}
        """Types of the configurations that activities bring objects to."""
        for activity in problem.motion_activities:
            for movable, value in activity.motion_effects.items():
                self.goals[activity.name, movable.object().name] = value.type
            for constraint in activity.motion_constraints:
                key = activity.name, constraint.movable.object().name
                self.goals[key] = constraint.waypoints[-1].type

    def of(self, name: str, stops: Mapping[str, float], broken: Mapping[str, Any]) -> Place:
        """Return where an object stands. ``stops`` says how far (m) robots under way still go, and
        ``broken`` where (x, y, theta) those are that are out of order.
        """
        for ride in self.plan.get("rides", ()):
            key = ride["activity"], ride["carrier"]
            if ride["object"] == name and self.state.phase[key[0]] is Phase.RUNNING:
                carrier, type_ = self.of(key[1], stops, broken)
                return Frame(*carrier).of(ride["offset"]), type_
        pose, type_ = self._last(name, stops)
        if name in broken:
            return tuple(float(v) for v in broken[name]), type_
        return pose, type_

    def _last(self, name: str, stops: Mapping[str, float]) -> Place:
        """Return where the last motion or change of an object has brought it."""
        (pose, type_), since = self.first[name], -math.inf
        for (activity, who), drive in self.drives.items():
            phase = self.state.phase[activity]
            begun = self.state.fired.get(Event(At.START, activity), -math.inf)
            if who != name or phase is Phase.WAITING or begun < since:
                continue
            over = phase is Phase.DONE or name not in stops
            at = drive.path.length if over else stops[name]
            home = self.frames[self.map_of[activity, who]].inverse
            since, type_ = begun, self.goals[activity, who]
            pose = home.of(drive.path.poses_at(np.array([at]))[0])
        for change in self.plan["changes"]:
            when = self.state.fired.get(Event(At.END, change["activity"]), -math.inf)
            if change["object"] == name and when > since:
                since, type_ = when, self.goals[change["activity"], name]
                pose = tuple(float(v) for v in change["configuration"])
        return pose, type_
