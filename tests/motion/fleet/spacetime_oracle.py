"""A planner of straight drives, and a naive judge of groups (shapely, dense sampling)."""

import math

import numpy as np
from shapely import LineString, Polygon
from shapely.affinity import affine_transform

from up_samp.geometry.maps import OccupancyGrid
from up_samp.model import (
    Body,
    Kinematics,
    MotionModel,
    Outcome,
    PathReport,
    TimedMotion,
    Trajectory,
)

RECTANGLE = ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.5), (-1.0, 0.5))
CAR = Body(RECTANGLE, Kinematics(MotionModel.REEDSSHEPP, 1.0, 2.0, 0.5))


def trapezoid(length, v_max, a_max, step=0.05):
    """Times and positions of the fastest rest-to-rest drive over ``length`` m."""
    ramp = min(length / 2, v_max**2 / (2 * a_max))
    top = math.sqrt(2 * a_max * ramp)
    t1, t2 = top / a_max, (length - 2 * ramp) / top
    end = 2 * t1 + t2
    n = max(2, math.ceil(end / step) + 1)
    t = np.linspace(0.0, end, n)
    back = end - t
    s = np.where(t < t1, a_max * t**2 / 2, ramp + (t - t1) * top)
    s = np.where(back < t1, length - a_max * back**2 / 2, s)
    s[0], s[-1] = 0.0, length
    return t, s


class Straight:
    """Drives straight from pose to pose, or says that something rests in the way."""

    def plan(self, query, deadline):
        way = LineString([p[:2] for p in query.poses]).buffer(0.5 + 1e-3, cap_style="flat")
        hit = [p.name for p in query.obstacles if placed(p.body, p.pose).intersects(way)]
        if hit:
            return PathReport(Outcome.OUT_OF_TIME, blockers=frozenset(hit), reason="blocked")
        times, poses, now = [np.zeros(1)], [np.array([query.poses[0]])], 0.0
        for a, b in zip(query.poses[:-1], query.poses[1:], strict=True):
            k = query.body.kinematics
            t, s = trapezoid(math.dist(a[:2], b[:2]), k.v_max * 0.999999, k.a_max * 0.999999)
            share = (s / s[-1])[1:, None]
            poses.append(np.array(a) + share * (np.array(b) - np.array(a)))
            times.append(now + t[1:])
            now += t[-1]
        return PathReport(Outcome.FOUND, Trajectory(np.concatenate(times), np.concatenate(poses)))


def placed(body, pose):
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return affine_transform(Polygon(body.footprint), [c, -s, s, c, pose[0], pose[1]])


def clearance(motions, trajectories, rests=(), step=0.02):
    """Least distance between any two bodies while one of them moves, by dense sampling."""
    end = max(t.end for t in trajectories.values()) + 1.0
    start = min(t.start for t in trajectories.values()) - 1.0
    least = math.inf
    for t in np.arange(start, end, step):
        there = []
        for m in motions:
            traj = trajectories[m.name]
            if min(m.present_from, traj.start) <= t <= max(m.present_until, traj.end):
                moving = traj.start < t < traj.end
                there.append((m.object, placed(m.body, traj.at(t)), moving, m.avoid))
        for r in rests:
            if r.since <= t <= r.until:
                there.append((r.name, placed(r.body, r.pose), False, frozenset()))
        for i, a in enumerate(there):
            for b in there[i + 1 :]:
                if a[0] == b[0]:
                    continue
                if (a[2] and (a[3] is None or b[0] in a[3])) or (
                    b[2] and (b[3] is None or a[0] in b[3])
                ):
                    least = min(least, a[1].distance(b[1]))
    return least


def room(width, height, free, resolution=0.1):
    """A map that is occupied but for the rectangles ``free`` (x0, y0, x1, y1)."""
    occupied = np.ones((round(height / resolution), round(width / resolution)), dtype=bool)
    for box in free:
        x0, y0, x1, y1 = (round(v / resolution) for v in box)
        occupied[y0:y1, x0:x1] = False
    return OccupancyGrid(occupied, resolution)


def motion(name, start, goal, release=0.0, due=1e9, **more):
    """A car's motion; the object is called like the motion, in capitals."""
    return TimedMotion(name, name.upper(), CAR, (start, goal), release, due, **more)


def judge(report, motions, rests=(), step=0.05):
    """Assert that a found group is safe, keeps its windows' release and the limits of a car."""
    assert report.outcome is Outcome.FOUND, report.reason
    assert clearance(motions, report.trajectories, rests, step) > 0.0
    for m in motions:
        trajectory = report.trajectories[m.name]
        assert trajectory.start >= m.release - 1e-9
        assert np.allclose(trajectory.poses[0, :2], m.poses[0][:2], rtol=0, atol=0)
        assert np.allclose(trajectory.poses[-1, :2], m.poses[-1][:2], rtol=0, atol=0)
        for i in (0, -1):
            turn = (trajectory.poses[i, 2] - m.poses[i][2]) / (2 * math.pi)
            assert abs(turn - round(turn)) < 1e-9
        found, k = limits(trajectory), m.body.kinematics
        assert found["v"] <= k.v_max * (1 + 1e-9)  # rounding
        assert found["a"] <= k.a_max * (1 + 1e-9)
        assert found["k"] <= 1 / k.turning_radius + 1e-6
        assert found["dt"] <= 0.05 + 1e-9
        assert found["slip"] < 1e-6
        late = trajectory.end > m.due + 1e-6
        assert late == (m.name in report.late)


def limits(trajectory):
    """Largest speed, acceleration, curvature and time step of a car's samples."""
    if len(trajectory.times) == 1:
        return {"v": 0.0, "a": 0.0, "k": 0.0, "dt": 0.0, "slip": 0.0}
    d = np.diff(trajectory.poses, axis=0)
    dt = np.diff(trajectory.times)
    half = d[:, 2] / 2
    grow = np.where(np.abs(half) < 1e-9, 1.0, half / np.where(half == 0, 1, np.sin(half)))
    heading = trajectory.poses[:-1, 2] + half
    along = grow * (np.cos(heading) * d[:, 0] + np.sin(heading) * d[:, 1])
    across = -np.sin(heading) * d[:, 0] + np.cos(heading) * d[:, 1]
    v = np.concatenate([[0.0], along / dt, [0.0]])
    gap = np.concatenate([[dt[0]], dt, [dt[-1]]])
    # of each difference what the rounding of two positions may make of it over steps that short
    rounding = 4 * np.finfo(float).eps * np.abs(trajectory.poses[:, :2]).max() / gap
    a = np.abs(np.diff(v)) - rounding[1:] - rounding[:-1]
    a /= 0.5 * (gap[1:] + gap[:-1])
    moving = np.abs(along) > 1e-9
    curvature = np.abs(d[moving, 2] / along[moving])
    return {
        "v": float(np.abs(v).max()),
        "a": float(a.max()),
        "k": float(curvature.max(initial=0.0)),
        "dt": float(dt[moving].max(initial=0.0)),
        "slip": float(np.abs(across).max()),
    }
