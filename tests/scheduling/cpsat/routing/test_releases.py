"""Tasks that nobody may start before some time: no schedule is shorter than the bounds by that."""

import itertools
import random
from dataclasses import replace

import pytest

from tests.scheduling.cpsat.sites import Site, Task, dispatch, small
from tests.scheduling.cpsat.styles import LOOSE, SPOILED, TIGHT
from tests.scheduling.cpsat.truth import bound_without_search, disagreement
from tests.scheduling.cpsat.writer import write
from up_samp.scheduling.cpsat.model import ScheduleModel
from up_samp.scheduling.cpsat.routing.detection import find_routes
from up_samp.scheduling.cpsat.routing.dispatch import find_work

STYLES = [*TIGHT, *LOOSE, *SPOILED]


def released(seed):
    """Return a small site with tasks that are released later, some but for the first robot."""
    rng, site = random.Random(seed), (small, dispatch)[seed % 2](seed)
    tasks = [
        replace(task, released=rng.choice([0, 4, 9, 17]), early=rng.random() < 0.4)
        for task in site.tasks
    ]
    return replace(site, tasks=tuple(tasks))


@pytest.mark.parametrize(
    "seeds",
    [range(12), *(pytest.param(range(k, k + 100), marks=pytest.mark.long) for k in (12, 112))],
)
def test_no_schedule_is_shorter_than_releases_say(seeds):
    wrong, told = {}, 0
    for seed in seeds:
        site, style = released(seed), STYLES[5 * seed % len(STYLES)]
        wrong[seed], some = disagreement(write(site, style))
        at_once = replace(site, tasks=tuple(replace(t, released=0) for t in site.tasks))
        if some:
            told += bound_without_search(write(site, style)) > bound_without_search(
                write(at_once, style)
            )
    assert not {seed: what for seed, what in wrong.items() if what is not None}
    assert told > len(seeds) / 5


@pytest.mark.parametrize("style", TIGHT[:12])
def test_a_task_is_released_in_whichever_way_it_is_done(style):
    roads = dict.fromkeys(itertools.permutations(range(3), 2), 3)
    for early in (False, True):
        tasks = (Task((2,), 2, released=30, early=early),)
        problem = write(Site((0, 1), roads, tasks), style)
        model = ScheduleModel(problem)
        (task,) = find_work(model, find_routes(model)).tasks
        assert task.release == (0 if early else 30)
        assert bound_without_search(problem) >= (0 if early else 32)
