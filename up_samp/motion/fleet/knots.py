"""Knots solved by construction: joint moves on roadmaps, made into drives that need few stops.

Where no order of priorities works, a plan for everybody is searched on roadmaps of rest poses
(:mod:`up_samp.motion.fleet.lacam`), coarse to fine. It is then made into few drives
(:mod:`up_samp.motion.fleet.loosening`). A planner's own path replaces the moves of a drive where it
finds one. Finding nothing proves nothing: the roadmaps leave poses out.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import shapely

from up_samp.geometry.scene import Scene
from up_samp.model import Body, Configuration, Deadline, Placed, TimedMotion, Trajectory
from up_samp.motion.fleet.abilities import abilities_of
from up_samp.motion.fleet.edges import Edge
from up_samp.motion.fleet.lacam import Agent, Joint
from up_samp.motion.fleet.loosening import Stage, Trip, loosened
from up_samp.motion.fleet.margins import kept
from up_samp.motion.fleet.moves import Move, drive, in_step
from up_samp.motion.fleet.paths import Path, hull_of, path_of
from up_samp.motion.fleet.roadmap import Roadmap, cells_of
from up_samp.motion.fleet.timed_path import TimedPath, avoids
from up_samp.motion.fleet.waiting import parked_all_the_time
from up_samp.motion.fleet.workspace import Workspace

DRAWS = ((4, 0), (4, 1), (1, 0), (1, 0))
"""Short and long searches on the roadmaps of each grain (see ``cells_of``), each with another draw.
The long one is for rooms of few places, where it sees them all.
"""


Drives = tuple[tuple[int, Path], ...]
"""Paths of robots at the same time: one, or several with a timing in which they keep clear."""


@dataclass
class Knot:
    """Robots that have to be moved together, and what rests around them."""

    workspace: Workspace
    scene: Scene
    motions: Sequence[TimedMotion]
    world: Sequence[TimedPath]
    paths: Sequence[Path | None]
    deadline: Deadline
    seed: int = 0
    margin: float = field(init=False)
    static: list[tuple[Placed, ...]] = field(init=False)

    def __post_init__(self) -> None:
        self.margin = _margin(self.workspace.margin, self.motions)
        self.static = [tuple(parked_all_the_time(m, self.world)) for m in self.motions]

    @property
    def heeds(self) -> list[list[bool]]:
        """Who has to keep apart from whom."""
        return [
            [
                a is not b and (avoids(a.avoid, b.object) or avoids(b.avoid, a.object))
                for b in self.motions
            ]
            for a in self.motions
        ]


def untie(
    workspace: Workspace,
    motions: Sequence[TimedMotion],
    alone: Mapping[str, TimedPath],
    world: Sequence[TimedPath],
    deadline: Deadline,
    seed: int = 0,
) -> list[Drives] | None:
    """Return drives (robot, path) in a sequence that brings everybody from start to goal, each one
    clear of all others at rest where the drives before left them; or None if none is found.

    ``alone`` are the runs of the motions without each other. For robots with two poses each and
    of different names.
    """
    scene = workspace.scene
    if scene is None or any(abilities_of(m.body).free for m in motions):
        return None
    paths = [alone[m.name].path if m.name in alone else None for m in motions]
    knot = Knot(workspace, scene, motions, world, paths, deadline, seed)
    known: list[list[Agent]] = []
    done: set[tuple[float, ...]] = set()
    tuning = workspace.tuning.knots
    for level, (short, long) in enumerate(DRAWS):
        attempts = [tuning.short] * short + [tuning.long] * long
        cells = tuple(cells_of(m.body, workspace.tuning.roadmap)[level] for m in motions)
        if cells in done or deadline.expired():
            continue
        done.add(cells)
        for own in (False, True):
            # marks on the robots' own paths are few and close: only where the lattice fails
            agents = _agents(knot, cells, own)
            if agents is None or any(agent.start not in agent.to_go for agent in agents):
                continue
            drives = untied(knot, agents, attempts)
            if drives is not None:
                return drives
            if deadline.expired() or _places(agents) > tuning.many:
                return None
            known.append(agents)
    # nobody can go first: some at the same time, then; in a ring there are three at least
    for agents in known if len(motions) > 2 else ():
        drives = (
            None if deadline.expired() else untied(knot, agents, (tuning.short,), together=True)
        )
        if drives is not None:
            return drives
    return None


def untied(
    knot: Knot, agents: Sequence[Agent], attempts: Sequence[int], *, together: bool = False
) -> list[Drives] | None:
    """Return drives that bring everybody from start to goal, if some are found."""
    found = _joint_moves(knot, agents, attempts, together)
    if found is None:
        return None
    joint, steps = found
    return _drives(knot, joint, loosened(joint, steps))


def _places(agents: Sequence[Agent]) -> int:
    return max(len(agent.roadmap.poses) for agent in agents)


def _margin(wish: float, motions: Sequence[TimedMotion]) -> float:
    """Return the clearance to keep: less than usual where robots start or end closer than that."""
    margin = wish
    for a, b in itertools.combinations(motions, 2):
        g, h = hull_of(a.body), hull_of(b.body)
        for i in (0, -1):
            margin = kept(margin, [np.array(a.poses[i])], g, [np.array(b.poses[i])], h)
    return margin


def _joint_moves(
    knot: Knot, agents: Sequence[Agent], attempts: Sequence[int], together: bool
) -> tuple[Joint, list[tuple[Edge, ...]]] | None:
    """Return joint moves on roadmaps of one grain, and who found them, if some are found."""
    places, tuning = _places(agents), knot.workspace.tuning.knots
    for attempt, most in enumerate(attempts):
        if most > tuning.short and places > tuning.few:
            continue
        joint = Joint(agents, knot.heeds, knot.margin, 100 * knot.seed + attempt, together, tuning)
        steps = joint.search(most, knot.deadline)
        if steps is not None:
            return joint, steps
        if joint.dry or knot.deadline.expired():
            break
    return None


def _agents(knot: Knot, cells: Sequence[float], marks: bool) -> list[Agent] | None:
    """Return the robots on roadmaps, one for each kind of body among the same resting things;
    ``marks``: with places along the robots' own paths.
    """
    kinds: dict[object, list[int]] = {}
    for i, motion in enumerate(knot.motions):
        around = frozenset((p.body.footprint, p.pose) for p in knot.static[i])
        kinds.setdefault((motion.body, around), []).append(i)
    agents: dict[int, Agent] = {}
    for robots in kinds.values():
        ends = [pose for i in robots for pose in knot.motions[i].poses]
        own = [path for i in robots if marks and (path := knot.paths[i]) is not None]
        body, static = knot.motions[robots[0]].body, knot.static[robots[0]]
        tuning = knot.workspace.tuning.roadmap
        roadmap = Roadmap(knot.scene, body, ends, own, static, cells[robots[0]], tuning)
        if not roadmap.usable or knot.deadline.expired():
            return None
        for i in robots:
            start, goal = (roadmap.place(pose) for pose in knot.motions[i].poses)
            agents[i] = Agent(roadmap, start, goal, roadmap.to_go(goal))
    return [agents[i] for i in range(len(knot.motions))]


def _drives(knot: Knot, joint: Joint, loose: Sequence[Stage]) -> list[Drives] | None:
    """Return the drives with a planner's paths where it finds shorter ones."""
    at: list[Configuration] = [m.poses[0] for m in knot.motions]
    found: list[Drives] = []
    for stage in loose:
        ends = {t.robot: joint.agents[t.robot].roadmap.poses[t.end] for t in stage}
        if len(stage) == 1:
            path = _drive(knot, joint, stage[0], at, ends[stage[0].robot])
            if path is None:
                return None
            found.append(((stage[0].robot, path),))
        else:
            found.append(_together(knot, stage, at, ends))
        for robot, end in ends.items():
            at[robot] = end
    return found


def _together(
    knot: Knot, stage: Stage, at: Sequence[Configuration], ends: Mapping[int, Configuration]
) -> Drives:
    """Return the paths of trips that are driven in step."""
    robots = [t.robot for t in stage]
    moves = [t.edges[0].move for t in stage]
    motions = in_step(moves, [knot.motions[i].body.kinematics for i in robots])
    return tuple(
        (i, path_of(_between(motion, at[i], ends[i]), knot.motions[i].body, _marks([move])))
        for i, move, motion in zip(robots, moves, motions, strict=True)
    )


def _drive(
    knot: Knot, joint: Joint, trip: Trip, at: Sequence[Configuration], end: Configuration
) -> Path | None:
    """Return a path for a trip: a planner's, or the moves themselves."""
    robot, motion = trip.robot, knot.motions[trip.robot]
    parked = [
        Placed(other.object, other.body, at[j])
        for j, other in enumerate(knot.motions)
        if joint.heeds[robot][j]
    ]
    air = knot.workspace.tuning.knots.air
    wide = [Placed(p.name, grown(p.body, air), p.pose) for p in parked]
    path = knot.workspace.detour(
        motion.body, (at[robot], end), knot.static[robot], wide, knot.deadline
    )
    moves = [edge.move for edge in trip.edges]
    whole = _between(drive(moves, motion.body.kinematics), at[robot], end)
    own = path_of(whole, motion.body, _marks(moves))
    options = sorted((p for p in (path, own) if p is not None), key=lambda p: p.natural.duration)
    rests = [knot.workspace.resting(p.body, p.pose) for p in parked]
    clear = (p for p in options if not any(len(knot.workspace.conflicts(p, r)) for r in rests))
    return next(clear, None)


def _between(motion: Trajectory, start: Configuration, goal: Configuration) -> Trajectory:
    """Return a motion with its ends exactly at two poses: a lattice's are off by rounding."""
    rows = motion.poses.copy()
    for k, pose in ((0, start), (-1, goal)):
        turns = 2 * math.pi * round((float(rows[k, 2]) - pose[2]) / (2 * math.pi))
        rows[k] = (pose[0], pose[1], pose[2] + turns)
    return Trajectory(motion.times.copy(), rows)


def grown(body: Body, by: float) -> Body:
    """Return the body with a footprint that is wider by ``by`` m on all sides."""
    ring = shapely.Polygon(body.footprint).buffer(by, join_style="mitre").exterior
    return replace(body, footprint=tuple((float(x), float(y)) for x, y in ring.coords[:-1]))


def _marks(moves: Sequence[Move]) -> list[Configuration]:
    marks = [tuple(float(v) for v in moves[0].rows[0])]
    return marks + [tuple(float(v) for v in m.rows[-1]) for m in moves]
