"""What it takes that one robot makes room for the next one: against drives looked at one by one,
and what that makes of assignments, against the same worked out by hand.
"""

import itertools
import math
import random
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.search.fleet.test_better_rounds import first_tours
from up_samp.motion.fleet.timed_path import natural_timing, run_of
from up_samp.search.fleet.evaluator import AssignmentEvaluator
from up_samp.search.fleet.travel_times import SECTORS

INF = math.inf


@pytest.fixture(scope="module", params=[0, 1])
def toured(request):
    _, (tours, _), _, assignment = first_tours((4, 8), seed=request.param)
    return tours, assignment


def first_free(workspace, leaver, path, comer, there):
    """Return when (s) one may arrive, at the soonest, if the other one leaves at 0 s."""
    gone = run_of(leaver, path, natural_timing(path, 0.0))
    for arrival in np.arange(0.0, 60.0, 0.05):
        came = natural_timing(there, arrival - there.natural.duration)
        if workspace.meeting(gone, run_of(comer, there, came))[0] == INF:
            return arrival
    return INF


def test_handovers_are_as_quick_as_ways_without_a_stop_allow(toured):
    tours, _ = toured
    floor, workspace = tours._floor, tours._floor._workspace
    motions = [tours._timed_as(name, 0.0) for name in tours._motions]
    told = []
    for leaver, comer in itertools.permutations(motions, 2):
        if leaver.object == comer.object or leaver.poses[0] != comer.poses[-1]:
            continue
        some, others = (floor.ways(m).quickest_first() for m in (leaver, comer))
        least, alone = INF, True
        for path, there in itertools.product(some, others):
            longer = path.natural.duration - some[0].natural.duration
            longer += there.natural.duration - others[0].natural.duration
            least = min(least, longer + first_free(workspace, leaver, path, comer, there))
            alone = alone and len(floor.passing(leaver, path, comer, there)) == 1
        seconds = floor.handover(leaver, comer)
        told.append(seconds)
        assert seconds <= least + 0.1
        if alone:  # else they may meet elsewhere, too
            assert seconds == pytest.approx(least, abs=0.1)
    assert len(told) > 5
    assert 1.0 < min(told) < max(told) < 30.0


def likely(known, place, goal, start):
    """Return how long a handover takes by those at the same place whose drives lie alike, each for
    itself; None where all lie too differently.
    """

    def tells(end, other):
        way, there = (math.atan2(y - place[1], x - place[0]) for x, y, *_ in (end, other))
        sector = math.pi / SECTORS + 2 * math.pi / SECTORS * math.floor(
            (way % (2 * math.pi)) / (2 * math.pi / SECTORS)
        )
        return math.exp(-((2 * math.sin((there - sector) / 2) / 0.12) ** 2))

    some = [(a, b, s) for ((_, at, a), (_, b, _)), s in known.items() if at == place]
    shares = [(tells(goal, a) * tells(start, b), s) for a, b, s in some if goal is not None]
    whole = sum(share for share, _ in shares)
    return sum(share * s for share, s in shares) / whole if whole > 1e-3 else None


def ends_by_hand(evaluator, tours):
    """Return when each robot has done its jobs if all places are taken in turns."""
    guess, jobs, snapshot = evaluator.guess, evaluator.jobs, evaluator.guess.snapshot
    body = {robot: snapshot.objects[robot].body for robot in tours}
    wanted = Counter()
    for options in jobs.options:
        wanted.update({pose for option in options for pose in option.stops})
    left, here, ready, last, ends = {}, {}, {}, {}, {}
    for robot, tour in tours.items():
        here[robot], ready[robot], left[robot] = (
            snapshot.configurations[snapshot.initial[robot]], 0.0, []
        )  # fmt: skip
        for j, k in tour:
            option = jobs.options[j][k]
            stays = (option.work + guess.pause(option)) / len(option.stops)
            left[robot] += [(pose, stays) for pose in option.stops]
    home = {r: guess.home(jobs.options[t[-1][0]][t[-1][1]]) for r, t in tours.items() if t}

    def comes(robot):
        return ready[robot] + guess.ride(robot, here[robot], left[robot][0][0])

    def is_left(robot):
        """All that a robot has to do from its next place on."""
        here, seconds = left[robot][0][0], 0.0
        for place, stays in left[robot]:
            seconds += guess.ride(robot, here, place) + stays
            here = place
        return seconds

    while any(left.values()):
        robot = min((r for r in evaluator.robots if left.get(r)), key=comes)
        place = left[robot][0][0]
        free = last[place][1] if wanted[place] > 1 and place in last else -INF
        waiting = [r for r in evaluator.robots if left.get(r) and left[r][0][0] == place]
        if evaluator.rules.at_once and free > comes(
            robot
        ):  # of those who wait the one that has most left to do
            robot = max((r for r in waiting if r == robot or comes(r) <= free), key=is_left)
        came, (place, stays) = comes(robot), left[robot].pop(0)
        if wanted[place] > 1 and place in last and last[place][0] != robot:
            other, free, goal = last[place]
            key = (body[other], place, goal), (body[robot], here[robot], place)
            gap = guess.handovers.get(key)
            gap = likely(guess.handovers, place, goal, here[robot]) if gap is None else gap
            came = max(came, free + (evaluator.rules.handover if gap is None else gap))
        ready[robot], here[robot] = came + stays, place
        goal = left[robot][0][0] if left[robot] else home[robot]
        last[place] = robot, ready[robot], goal
        ends[robot] = ready[robot]
    for robot, tour in tours.items():
        away = tour and home[robot] is not None and wanted[here[robot]] > 1
        if away and last[here[robot]][0] != robot:
            ends[robot] += guess.ride(robot, here[robot], home[robot])
    return ends


@pytest.mark.parametrize("at_once", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_shares_take_what_is_known_of_their_handovers(toured, seed, at_once):
    _, assignment = toured
    rules = assignment.evaluator.rules._replace(at_once=at_once)
    rng, usual = random.Random(seed), replace(assignment.evaluator, rules=rules)
    exact = AssignmentEvaluator(usual.guess, usual.jobs, usual.rules, exact=True)
    usual.guess.handovers.clear()
    usual.guess.rounds += 1
    assert exact.ends(assignment.tours) == usual.ends(assignment.tours)
    robots, options = usual.robots, usual.jobs.options
    for _ in range(5):
        jobs = rng.sample(range(len(options)), len(options))
        tours = {robot: [] for robot in robots}
        for j in jobs:
            k = rng.randrange(len(options[j]))
            tours[options[j][k].robot].append((j, k))
        for pair in rng.sample(
            some := replace(assignment, tours=tours).handovers(), len(some) // 2
        ):
            drives = tuple((usual.guess.snapshot.objects[r].body, a, b) for r, a, b in pair)
            usual.guess.handovers[drives] = float(rng.randint(0, 40))
        usual.guess.rounds += 1
        told = {robot: end for robot, (end, _) in exact.ends(tours).items() if tours[robot]}
        assert told == pytest.approx(ends_by_hand(exact, tours))
        alike = usual.ends(tours)  # what was written down for it is not what the other one asks
        assert replace(usual, exact=True).ends(tours) == exact.ends(tours)
        assert replace(exact, exact=False).ends(tours) == alike
