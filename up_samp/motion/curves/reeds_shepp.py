"""Paths as arcs, and the fastest of them without obstacles.

A path is rows of (curvature 1/m, signed length m) driven one after the other from a pose; a
negative length is driven backwards. A *run* is a maximal stretch in one direction; a car rests
between runs.

Reeds-Shepp curves are the shortest or fastest ways of a car between two poses without obstacles:
all words of Reeds & Shepp, "Optimal paths for a car that goes both forwards and backwards", Pacific
J. Math. 145 (1990), sections 8.1 to 8.11, with their time flips, reflections and reversals. For the
*fastest* way (rest at each cusp, trapezoidal speed between cusps) the words without cusps are
taken with arcs up to a full turn, too: a detour can beat a stop. These are all there is to a car
that drives one way only (Dubins, "On curves of minimal length with a constraint on average
curvature, and with prescribed initial and terminal positions and tangents", Amer. J. Math. 79,
1957).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from up_samp.geometry.kernels import advance
from up_samp.geometry.records import inner, kernel
from up_samp.model.arrays import FloatArray

Pose = tuple[float, float, float]


class DriveLimits(NamedTuple):
    """What a body can do: turning ``radius`` (m; only a car's counts), top speed ``v`` (m/s),
    acceleration ``a`` (m/s^2). ``sense``: 0 if it drives both ways, 1 ahead only, -1 backwards only
    (how a search that begins at the goal drives a car that goes ahead only). ``omega`` (rad/s): how
    fast it turns on the spot, which for a car is an arc of the curvature ``SPOT`` (0: it does not).
    """

    radius: float
    v: float
    a: float
    sense: float = 0.0
    omega: float = 0.0


SPOT = 1e6
"""Curvature (1/m) of turns on the spot: hardly a micrometre is driven, be it backwards."""
MAX_ARCS = 5
MAX_WORDS = 12
TINY = 1e-10
LOW = -1e-12
QUARTER = 0.5 * math.pi


@kernel
def run_time(length: float, v: float, a: float) -> float:
    """Return the rest-to-rest time (s) over ``length`` m with top speed v (m/s) and acceleration a
    (m/s^2): a trapezoid, or a triangle if it is too short. ``a = inf`` gives length / v.
    """
    if length >= v * v / a:
        return length / v + v / a
    return 2.0 * math.sqrt(max(length, 0.0) / a)


@inner
def on_spot(kappa: float, car: DriveLimits) -> bool:
    """Return whether an arc is a turn on the spot."""
    return car.omega > 0.0 and abs(kappa) >= SPOT


@inner
def driven_on(
    time: float, run: float, kappa: float, s: float, car: DriveLimits
) -> tuple[float, float]:
    """Return the time (s) of the closed runs, and the signed length (m) of the open one, after
    another ``s`` m: where it turns back or on the spot, the run before is closed.
    """
    if on_spot(kappa, car):
        return time + run_time(abs(run), car.v, car.a) + abs(kappa * s) / car.omega, 0.0
    if run * s < 0.0:
        return time + run_time(abs(run), car.v, car.a), s
    return time, run + s


@inner
def wrapped(angle: float) -> float:
    """Return the angle in (-pi, pi]."""
    angle = angle % (2.0 * math.pi)
    return angle - 2.0 * math.pi if angle > math.pi else angle


@inner
def _turn(angle: float) -> float:
    """Return the angle in [0, 2 pi), rounding noise below a full turn down to 0."""
    angle = angle % (2.0 * math.pi)
    return 0.0 if angle > 2.0 * math.pi - 1e-9 else angle


@inner
def _put(
    words: FloatArray,
    n: int,
    sides: tuple[float, float, float, float],
    lengths: tuple[float, float, float, float, float],
) -> int:
    """Add a word to the list: its form (turn of the first arc, of the others) and its lengths."""
    for i in range(4):
        words[n, i] = sides[i]
    for i in range(MAX_ARCS):
        words[n, 5 + i] = lengths[i]
    return n + 1


@inner
def _tau_omega(u: float, v: float, xi: float, eta: float, phi: float) -> tuple[float, float]:
    delta = wrapped(u - v)
    A = math.sin(u) - math.sin(delta)
    B = math.cos(u) - math.cos(delta) - 1.0
    t1 = math.atan2(eta * A - xi * B, xi * A + eta * B)
    t2 = 2.0 * (math.cos(delta) - math.cos(v) - math.cos(u)) + 3.0
    tau = wrapped(t1 + math.pi) if t2 < 0.0 else wrapped(t1)
    return tau, wrapped(tau - u + v - phi)


@inner
def _words(x: float, y: float, phi: float, words: FloatArray, n: int) -> int:
    """List the words to (x, y, phi) that start with a left turn (numbers: sections of the
    paper).
    """
    s_phi, c_phi = math.sin(phi), math.cos(phi)
    # same-side words start from (xi, eta), opposite-side words from (xo, eo)
    xi, eta = x - s_phi, y - 1.0 + c_phi
    xo, eo = x + s_phi, y - 1.0 - c_phi
    r, theta = math.sqrt(xi * xi + eta * eta), math.atan2(eta, xi)
    ro, to = math.sqrt(xo * xo + eo * eo), math.atan2(eo, xo)
    # 8.1 L+ S+ L+ (arcs up to a full turn)
    t = _turn(theta)
    n = _put(words, n, (1.0, 0.0, 1.0, 0.0), (t, r, _turn(phi - t), 0.0, 0.0))
    if ro >= 2.0:  # 8.2 L+ S+ R+
        u = math.sqrt(ro * ro - 4.0)
        t = _turn(to + math.atan2(2.0, u))
        n = _put(words, n, (1.0, 0.0, -1.0, 0.0), (t, u, _turn(t - phi), 0.0, 0.0))
        u = 4.0 - u
        if u <= 0.0:  # 8.11 L+ R- S- L- R+
            t = wrapped(math.atan2((4.0 - u) * xo - 2.0 * eo, -2.0 * xo + (u - 4.0) * eo))
            v = wrapped(t - phi)
            if t >= LOW and v >= LOW:
                n = _put(words, n, (1.0, -1.0, 0.0, 1.0), (t, -QUARTER, u, -QUARTER, v))
                words[n - 1, 4] = -1.0
    if ro <= 2.0:  # 8.7 L+ R+ L- R-
        u = math.acos(min(1.0, 0.25 * (2.0 + ro)))
        t, v = _tau_omega(u, -u, xo, eo, phi)
        if t >= LOW and v <= -LOW:
            n = _put(words, n, (1.0, -1.0, 1.0, -1.0), (t, u, -u, v, 0.0))
    rho = (20.0 - ro * ro) / 16.0
    if 0.0 <= rho <= 1.0:  # 8.8 L+ R- L- R+
        u = -math.acos(rho)
        t, v = _tau_omega(u, u, xo, eo, phi)
        if t >= LOW and v >= LOW:
            n = _put(words, n, (1.0, -1.0, 1.0, -1.0), (t, u, u, v, 0.0))
    if r <= 4.0:  # L+ R+ L+ without cusps
        u = -2.0 * math.asin(0.25 * r)
        t = _turn(theta + 0.5 * u + math.pi)
        long = (t, u + 2.0 * math.pi, _turn(phi - t + u), 0.0, 0.0)
        n = _put(words, n, (1.0, -1.0, 1.0, 0.0), long)
    n = _reversible(x, y, phi, words, n)
    middle = n
    n = _reversible(x * c_phi + y * s_phi, x * s_phi - y * c_phi, phi, words, n)
    for i in range(middle, n):  # found from the other end
        for k in range(2):
            j = MAX_ARCS - 1 - k
            words[i, k], words[i, j] = words[i, j], words[i, k]
            words[i, 5 + k], words[i, 5 + j] = words[i, 5 + j], words[i, 5 + k]
    return n


@inner
def _reversible(x: float, y: float, phi: float, words: FloatArray, n: int) -> int:
    """List the words that differ when driven from the other end."""
    s_phi, c_phi = math.sin(phi), math.cos(phi)
    xi, eta = x - s_phi, y - 1.0 + c_phi
    xo, eo = x + s_phi, y - 1.0 - c_phi
    r, theta = math.sqrt(xi * xi + eta * eta), math.atan2(eta, xi)
    ro = math.sqrt(xo * xo + eo * eo)
    if r <= 4.0:  # 8.3, 8.4 L+ R- L(+ or -)
        u = -2.0 * math.asin(0.25 * r)
        t = wrapped(theta + 0.5 * u + math.pi)
        if t >= LOW:
            n = _put(words, n, (1.0, -1.0, 1.0, 0.0), (t, u, wrapped(phi - t + u), 0.0, 0.0))
    if r >= 2.0:  # 8.9 L+ R- S- L-
        root = math.sqrt(r * r - 4.0)
        t = wrapped(theta + math.atan2(root, -2.0))
        v = wrapped(phi - QUARTER - t)
        if t >= LOW and v <= -LOW:
            n = _put(words, n, (1.0, -1.0, 0.0, 1.0), (t, -QUARTER, 2.0 - root, v, 0.0))
    if ro >= 2.0:  # 8.10 L+ R- S- R-
        t = math.atan2(xo, -eo)
        v = wrapped(t + QUARTER - phi)
        if t >= LOW and v <= -LOW:
            n = _put(words, n, (1.0, -1.0, 0.0, -1.0), (t, -QUARTER, 2.0 - ro, v, 0.0))
    return n


@inner
def _time_of(
    words: FloatArray, i: int, flip: float, car: DriveLimits, runs: tuple[float, float]
) -> float:
    """Return the time (s) of a word between the runs before and after it; 1e300 if it drives where
    the car cannot.
    """
    scale = flip * car.radius
    time, run = 0.0, runs[0]
    for k in range(MAX_ARCS + 1):
        s = runs[1] if k == MAX_ARCS else words[i, 5 + k] * scale
        if abs(s) > TINY:
            if car.sense * s < 0.0 and k < MAX_ARCS:
                return 1e300
            time, run = driven_on(time, run, 0.0, s, car)
    return time + run_time(abs(run), car.v, car.a)


@kernel
def connect(
    start: Pose, goal: Pose, car: DriveLimits, runs: tuple[float, float], out: FloatArray
) -> tuple[float, int]:
    """Find the fastest Reeds-Shepp curve between two poses.

    ``runs``: the signed lengths (m) of the driving runs before and after the curve, which it
    continues without a stop if it keeps their direction (0: rest). ``out`` (5, 2) receives
    curvature (1/m) and signed length (m) of the arcs. Returns the time (s) including those runs,
    and the number of arcs. With v = 1 and a = inf the time is the length.
    """
    radius = car.radius
    dx, dy = (goal[0] - start[0]) / radius, (goal[1] - start[1]) / radius
    c, s = math.cos(start[2]), math.sin(start[2])
    x, y, phi = c * dx + s * dy, c * dy - s * dx, wrapped(goal[2] - start[2])
    words = np.zeros((4 * MAX_WORDS, 2 * MAX_ARCS))
    best, chosen, best_flip, best_mirror = 1e300, 0, 1.0, 1.0
    n = 0
    for i in range(4):
        flip = 1.0 if i < 2 else -1.0
        mirror = 1.0 if i % 2 == 0 else -1.0
        first = n
        n = _words(flip * x, mirror * y, flip * mirror * phi, words, n)
        for k in range(first, n):
            time = _time_of(words, k, flip, car, runs)
            if time < best - 1e-12:
                best, chosen, best_flip, best_mirror = time, k, flip, mirror
    count = 0
    for k in range(MAX_ARCS):
        s = words[chosen, 5 + k] * best_flip * radius
        if abs(s) > TINY:
            out[count, 0] = words[chosen, k] * best_mirror / radius
            out[count, 1] = s
            count += 1
    return best, count


def shortest(
    start: tuple[float, ...], goal: tuple[float, ...], radius: float, sense: float = 0.0
) -> tuple[float, FloatArray]:
    """Return length (m) and arcs (n, 2: curvature 1/m, signed length m) of the shortest curve."""
    return fastest(start, goal, DriveLimits(radius, 1.0, math.inf, sense))


def fastest(
    start: tuple[float, ...], goal: tuple[float, ...], car: DriveLimits
) -> tuple[float, FloatArray]:
    """Return time (s) and arcs (n, 2) of the fastest curve from rest to rest (rest at cusps)."""
    out = np.empty((MAX_ARCS, 2))
    car = DriveLimits(*map(float, car))
    (x0, y0, th0), (x1, y1, th1) = (map(float, pose[:3]) for pose in (start, goal))
    cost, n = connect((x0, y0, th0), (x1, y1, th1), car, (0.0, 0.0), out)
    return float(cost), out[:n].copy()


# ------------------ Paths as arcs


@kernel
def path_time(arcs: FloatArray, car: DriveLimits) -> float:
    """Return the time (s) to drive ``arcs`` (n, 2) from rest to rest, resting at each cusp."""
    time, run = 0.0, 0.0
    for i in range(arcs.shape[0]):
        time, run = driven_on(time, run, arcs[i, 0], arcs[i, 1], car)
    return time + run_time(abs(run), car.v, car.a)


@kernel
def nodes_of(start: FloatArray, arcs: FloatArray) -> FloatArray:
    """Return the poses (n + 1, 3) at the ends of the arcs; theta is continuous."""
    nodes = np.empty((arcs.shape[0] + 1, 3))
    nodes[0, 0], nodes[0, 1], nodes[0, 2] = start[0], start[1], start[2]
    for i in range(arcs.shape[0]):
        x, y, th = advance(nodes[i, 0], nodes[i, 1], nodes[i, 2], arcs[i, 0], arcs[i, 1])
        nodes[i + 1, 0], nodes[i + 1, 1], nodes[i + 1, 2] = x, y, th
    return nodes


@kernel
def merged(arcs: FloatArray) -> FloatArray:
    """Return the same path with neighbours of equal curvature and direction joined."""
    out = np.empty((arcs.shape[0], 2))
    n = 0
    for i in range(arcs.shape[0]):
        if abs(arcs[i, 1]) <= TINY:
            continue
        if n > 0 and abs(out[n - 1, 0] - arcs[i, 0]) < 1e-12 and out[n - 1, 1] * arcs[i, 1] > 0.0:
            out[n - 1, 1] += arcs[i, 1]
        else:
            out[n, 0], out[n, 1] = arcs[i, 0], arcs[i, 1]
            n += 1
    return out[:n].copy()


@kernel
def ends_of(arcs: FloatArray) -> FloatArray:
    """Return the distance (m) driven at the end of each arc."""
    out = np.empty(arcs.shape[0])
    total = 0.0
    for i in range(arcs.shape[0]):
        total += abs(arcs[i, 1])
        out[i] = total
    return out


def reversed_arcs(arcs: FloatArray) -> FloatArray:
    """Return the arcs of the same path driven from its end to its start."""
    out = arcs[::-1].copy()
    out[:, 1] *= -1.0
    return out


def length_of(arcs: FloatArray) -> float:
    """Return the length (m) of a path."""
    return float(np.abs(arcs[:, 1]).sum())
