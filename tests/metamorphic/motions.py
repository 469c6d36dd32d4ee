"""One site with motions, written as a scheduling and motion planning problem in many styles."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields, replace

from unified_planning.model import Fluent, TimePointInterval, Timing
from unified_planning.model.motion import (
    SE2,
    ActivityWaypoints,
    ConfigurationKind,
    ConfigurationObject,
    MotionModels,
    MovableObject,
    OccupancyMap,
    SchedulingMotionProblem,
)
from unified_planning.shortcuts import (
    FALSE,
    GE,
    LE,
    TRUE,
    BoolType,
    ConfigurationType,
    Equals,
    Iff,
    MovableType,
    Not,
    Or,
    Plus,
)

from tests.metamorphic.sites import GAP, PREPARE, ROBOT, MotionSite
from tests.scheduling.cpsat.styles import Style, numbered
from tests.scheduling.cpsat.writer import Writer, listed

LEAF = GAP / 2 + 0.1
LONGEST = 60
LONG = 15
"""Durations of moves: more than each needs."""


@dataclass(frozen=True)
class MotionStyle(Style):
    """How a site with motions is written.

    ``obstacles``: doors and robots as "lists", "dicts" or "mixed"; "moving" lists all of them as
    dynamic obstacles; "none" names nobody, so that all count; "asymmetric" lists those robots only
    that were there before. ``lasts`` "long": every move takes ``LONG``. ``at``: a task with a
    choice of places has a condition "or", or a "parameter" of a configuration type. ``team``:
    who does a whole team's tasks is said by "variables" or by "presences".
    """

    obstacles: str = "dicts"
    at: str = "or"
    team: str = "variables"
    hands: str = "fluent"

    @property
    def units(self) -> tuple[int, ...]:
        """As for any style; doors that may open while others drive, and those whose fluent
        lags behind, differ from others, too.
        """
        everybody = self.obstacles in ("none", "moving")
        late = self.obstacles == "dicts" and self.arrive == "end"
        fewer = self.obstacles == "asymmetric"
        known = (int(everybody), int(late), int(fewer), int(self.lasts == "long"))
        # (who is asked for a door is a matter of motions here)
        return (*super().units[:-1], *known)

    def __str__(self) -> str:
        base = MotionStyle()
        changed = [f.name for f in fields(self) if getattr(self, f.name) != getattr(base, f.name)]
        return ", ".join(f"{name} {getattr(self, name)}" for name in changed) or "published"


M = MotionStyle
ALIKE = numbered([
    M(),
    M(origin="until end"),
    M(lasts="bounds", obstacles="lists"),
    M(alone="implies", order="implies", obstacles="mixed"),
    M(alone="not both", one_of="nested", team="presences"),
    M(alone="uses", machine="uses", hands="pairs"),
    M(alone="level", lasts="bounds"),
    M(one_of="inside", order="inside", at="parameter"),
    M(one_of="variables", machine="uses", obstacles="lists"),
    M(fluents="parameter", alone="uses", one_of="nested", order="inside"),
    M(fluents="precedences", obstacles="lists", hands="pairs"),
    M(
        fluents="precedences", alone="uses", one_of="nested", order="inside", machine="uses",
        obstacles="lists", team="presences", hands="pairs",
    ),
    M(),
    M(fluents="precedences", lasts="bounds", obstacles="lists", hands="pairs"),
    M(fluents="parameter", obstacles="mixed", alone="level", one_of="inside"),
    M(fluents="precedences", rivals="leaving", obstacles="lists", hands="pairs"),
    M(moves="leave"),
    M(moves="leave", alone="uses", obstacles="lists"),
])  # fmt: skip
"""Styles that mean the same, unit by unit."""
OTHERS = numbered(
    [
        M(arrive="end", alone="strictly", machine="strictly", origin="whole"),
        M(arrive="end", alone="strictly", machine="busy", fluents="parameter"),
        M(arrive="end", alone="strictly", machine="strictly", obstacles="lists", origin="whole"),
        M(arrive="end", alone="busy", machine="held", obstacles="mixed"),
        M(alone="busy", machine="busy", order="inside", one_of="nested"),
        M(alone="held", machine="held", fluents="parameter", obstacles="lists"),
        M(alone="busy", machine="held", fluents="precedences", obstacles="lists", hands="pairs"),
        M(obstacles="none"),
        M(obstacles="moving", alone="uses", one_of="nested"),
        M(obstacles="none", fluents="precedences", hands="pairs"),
        M(obstacles="asymmetric"),
        M(obstacles="asymmetric", alone="implies", one_of="nested"),
        M(obstacles="asymmetric", fluents="precedences", hands="pairs"),
        M(lasts="long"),
        M(lasts="long", arrive="start + d", alone="uses"),
        M(lasts="long", way="road", obstacles="lists"),
    ]
)
"""Styles with meanings of their own: those of equal ``units`` mean the same."""


LASTS = {"fixed": (1, LONGEST), "bounds": (2, 99), "long": (LONG, LONG)}


def write(site: MotionSite, style: MotionStyle, folder) -> SchedulingMotionProblem:
    """Return a site written in a style; its map goes into ``folder``."""
    return listed(MotionWriter(site, style, folder).problem, style)


class MotionWriter(Writer):
    """Writes one problem with motions."""

    site: MotionSite
    style: MotionStyle

    def __init__(self, site: MotionSite, style: MotionStyle, folder) -> None:
        self.map_file = site.floor.write(folder, site.name)
        super().__init__(site, replace(style))

    # -- objects ---------------------------------------------------------------------------------
    def _begin(self):
        problem = SchedulingMotionProblem(f"{self.site.name} in style: {self.style}")
        floor = OccupancyMap(str(self.map_file), SE2(0.0, 0.0, 0.0))
        self.spot = ConfigurationType(f"spot_{self.site.name}", floor, ConfigurationKind.SE2)
        self.robot, self.leaf = MovableType("robot"), MovableType("leaf")
        self.spots, self.bodies = {}, []

        def place(name, pose):
            found = ConfigurationObject(name, self.spot, SE2(*pose))
            problem.add_object(found)
            return found

        for p in self.site.places:
            self.spots[p] = place(f"p{p}", self.site.floor.poses[p])
        for r in self.robots:
            body = MovableObject(
                f"r{r}",
                self.robot,
                footprint=list(ROBOT),
                motion_model=MotionModels.SE2,
                motion_parameters={"v_max": 1.0, "a_max": 0.5, "omega_max": 1.0},
            )
            problem.add_object(body)
            problem.set_initial_configuration(body, self.spots[self.site.starts[r]])
            self.bodies.append(body)
        if self.style.way == "road":
            poses = [self.site.floor.poses[self.site.starts[r]] for r in self.robots]
            self.roads = [place(f"road{r}", pose) for r, pose in enumerate(poses)]
        self.doors = {}
        for p, (shut, away) in self.site.floor.leaves.items():
            leaf = MovableObject(
                f"d{abs(p)}",
                self.leaf,
                footprint=[(-LEAF, -0.1), (LEAF, -0.1), (LEAF, 0.1), (-LEAF, 0.1)],
                motion_model=MotionModels.SE2,
            )
            problem.add_object(leaf)
            closed = place(f"shut{abs(p)}", shut)
            problem.set_initial_configuration(leaf, closed)
            self.doors[p] = (leaf, closed, place(f"away{abs(p)}", away))
        return problem

    def _doors(self):
        if self.style.fluents == "precedences":
            return {}
        if self.style.fluents == "parameter" and self.doors:
            fluent = Fluent("door_at", self.spot, door=self.leaf)
            self.problem.add_fluent(fluent)
            for leaf, closed, _ in self.doors.values():
                self.problem.set_initial_value(fluent(leaf), closed)
            return {p: fluent(leaf) for p, (leaf, _, _) in self.doors.items()}
        return {
            p: self.problem.add_fluent(
                f"door{abs(p)}_at", self.spot, default_initial_value=closed
            )()
            for p, (_, closed, _) in self.doors.items()
        }

    # -- motions ---------------------------------------------------------------------------------
    def _road(self, r, a, b, length):
        m = self.problem.add_motion_activity(f"move{a}to{b}by{r}", 1, optional=True)
        m.set_duration_bounds(*LASTS[self.style.lasts])
        static, dynamic = self._obstacles(r)
        m.add_motion_constraint(
            ActivityWaypoints(self.bodies[r], self.spots[a], [self.spots[b]], static, dynamic)
        )
        m.add_motion_effect(self.bodies[r], self.spots[b])
        return m

    def _guide(self, r, origin, roads, copy):
        name = "go" if origin is None else f"leave{origin}"
        m = self.problem.add_motion_activity(f"{name}copy{copy}by{r}", 1, optional=True)
        m.set_duration_bounds(*LASTS[self.style.lasts])
        self._decide(m, origin)
        source, to = self.ends[m.name]
        m.add_motion_constraint(
            ActivityWaypoints(self.bodies[r], source, [to], *self._obstacles(r))
        )
        m.add_motion_effect(self.bodies[r], to)
        return m

    def _obstacles(self, r):
        """Return the static and the dynamic obstacles of a robot's moves."""
        how = self.style.obstacles
        leaves = {p: leaf for p, (leaf, _, _) in self.doors.items()}
        others = [q for q in self.robots if q != r]
        if how == "none":
            return None, None
        if how == "moving":
            return [], [*leaves.values(), *(self.bodies[q] for q in others)]
        static = list(leaves.values())
        if how == "dicts":
            static = {leaf: self.open[p] for p, leaf in leaves.items()}
        if how == "asymmetric":
            return static, [self.bodies[q] for q in others if q < r]
        if how == "lists":
            return static, [self.bodies[q] for q in others]
        return static, {self.bodies[q]: self.at[q] for q in others}

    def _opening(self, r, p):
        a = self.problem.add_motion_activity(f"open{abs(p)}by{r}", 1, optional=True)
        leaf, _, away = self.doors[p]
        a.add_motion_effect(leaf, away)
        if p in self.open:
            a.add_effect(Timing(0 if self.style.arrive == "end" else -1, a.end), self.open[p], away)
        return a

    # -- tasks -----------------------------------------------------------------------------------
    def _able(self, t):
        return self.site.only.get(t, self.robots)

    def _where(self):
        if self.style.at != "parameter":
            super()._where()
            return
        works = [(a, self.site.tasks[t].places) for _, a, t in self.works]
        chosen = {a.name: places for a, places in works if len(places) > 1}
        plain = Writer._needs
        self._needs = lambda: [n for n in plain(self) if n[1].name not in chosen]
        super()._where()
        for r, a, _ in self.works:
            if a.name in chosen:
                to = a.add_parameter("where", self.spot)
                a.add_constraint(Or([Equals(to, self.spots[p]) for p in chosen[a.name]]))
                a.add_condition(TimePointInterval(Timing(0, a.start)), Equals(self.at[r], to))

    def _finish(self):
        by = {(t, r): a for r, a, t in self.works}
        for number, team in enumerate(self.site.teams):
            self._one_robot(number, team, by)
        self._hands(by)
        prepared = [self._prepare(t, by) for t in self.site.prepared]
        for a, b in itertools.combinations(prepared, 2):
            self.problem.add_constraint(Or(LE(a.end, b.start), LE(b.end, a.start)))

    def _one_robot(self, number, team, by):
        able = set(self.robots).intersection(*(self._able(t) for t in team))
        for t in team:
            for r in self._able(t):
                if r not in able:
                    self.problem.add_constraint(Not(by[t, r].present))
        for r in sorted(able):
            some = [by[t, r] for t in team]
            if self.style.team == "presences":
                for a, b in itertools.pairwise(some):
                    self.problem.add_constraint(Iff(a.present, b.present))
                continue
            who = self.problem.add_variable(f"team{number}by{r}", BoolType())
            for a in some:
                self.problem.add_constraint(Iff(who, a.present))

    def _hands(self, by):
        """Say that a robot carries one thing at a time, from its load to its unload."""
        for r in self.robots:
            pairs = [(by[a, r], by[b, r]) for a, b in self.site.carried]
            for load, unload in pairs:
                self.problem.add_constraint(Iff(load.present, unload.present))
            if self.style.hands == "pairs":
                for (l1, u1), (l2, u2) in itertools.combinations(pairs, 2):
                    apart = Or(LE(u1.end, l2.start), LE(u2.end, l1.start))
                    self.problem.add_constraint(apart, [l1.present, l2.present])
            elif pairs:
                free = self.problem.add_fluent(f"hands{r}", BoolType(), default_initial_value=True)
                for load, unload in pairs:
                    load.add_condition(TimePointInterval(Timing(0, load.start)), free)
                    load.add_effect(Timing(-1, load.end), free, FALSE())
                    unload.add_effect(Timing(-1, unload.end), free, TRUE())

    def _prepare(self, t, by):
        length, early, late = PREPARE
        prepare = self.problem.add_activity(f"prepare{t}", duration=length)
        for r in self._able(t):
            a = by[t, r]
            a.add_constraint(GE(a.start, Plus(prepare.start, early)))
            a.add_constraint(LE(a.end, Plus(prepare.start, late)))
        return prepare
