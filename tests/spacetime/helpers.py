"""A planner of straight drives, and a naive judge of groups (shapely, dense sampling)."""

import math

import numpy as np
from shapely import Polygon
from shapely.affinity import affine_transform

from up_samp.model import (
    Body,
    Kinematics,
    MotionModel,
    Outcome,
    PathReport,
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
    """Drives straight from pose to pose, whatever the obstacles."""

    def plan(self, query, deadline):
        times, poses, now = [np.zeros(1)], [np.array([query.poses[0]])], 0.0
        for a, b in zip(query.poses[:-1], query.poses[1:], strict=True):
            t, s = trapezoid(
                math.dist(a[:2], b[:2]), query.body.kinematics.v_max, query.body.kinematics.a_max
            )
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


def limits(trajectory):
    """Largest speed, acceleration, curvature and time step of a car's samples."""
    d = np.diff(trajectory.poses, axis=0)
    dt = np.diff(trajectory.times)
    half = d[:, 2] / 2
    grow = np.where(np.abs(half) < 1e-9, 1.0, half / np.where(half == 0, 1, np.sin(half)))
    heading = trajectory.poses[:-1, 2] + half
    along = grow * (np.cos(heading) * d[:, 0] + np.sin(heading) * d[:, 1])
    across = -np.sin(heading) * d[:, 0] + np.cos(heading) * d[:, 1]
    v = np.concatenate([[0.0], along / dt, [0.0]])
    gap = np.concatenate([[dt[0]], dt, [dt[-1]]])
    a = np.diff(v) / (0.5 * (gap[1:] + gap[:-1]))
    moving = np.abs(along) > 1e-9
    curvature = np.abs(d[moving, 2] / along[moving])
    return {
        "v": float(np.abs(v).max()),
        "a": float(np.abs(a).max()),
        "k": float(curvature.max(initial=0.0)),
        "dt": float(dt[moving].max(initial=0.0)),
        "slip": float(np.abs(across).max()),
    }
