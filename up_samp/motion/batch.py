"""Planning many legs ahead, in parallel processes."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import IO, Any

from up_samp.geometry import OccupancyGrid
from up_samp.model import (
    Body,
    Configuration,
    Deadline,
    EngineError,
    Outcome,
    PathQuery,
    Placed,
    UnsupportedError,
)
from up_samp.motion.protocol import Leg, LegQuery
from up_samp.motion.service import MotionService
from up_samp.motion.tuning import MotionTuning
from up_samp.system import child

Pair = tuple[Body, Configuration, Configuration]

_GRACE = 10.0
"""Time (s) that a child gets beyond the deadline, to start and to hand over what it has."""


@dataclass(frozen=True)
class _Job:
    """What a child is asked for: legs on one map, with the service's settings."""

    grid: OccupancyGrid | None
    planner: str
    margin: float
    seed: int
    tuning: MotionTuning
    pairs: tuple[Pair, ...]
    obstacles: tuple[Placed, ...]
    seconds: float


def precompute(
    service: MotionService,
    pairs: Iterable[Pair],
    processes: int = 1,
    obstacles: tuple[Placed, ...] = (),
    deadline: Deadline | None = None,
) -> int:
    """Plan all pairs (once per pair and its reverse) and put the legs into the service's cache.

    Return how many are known then. Raises :class:`UnsupportedError` where a body cannot be sent to
    another process (its control model is no function of an importable module), and
    :class:`EngineError` where such a process dies.
    """
    deadline = deadline or Deadline.never()
    todo = _distinct(service, pairs)
    if processes <= 1 or len(todo) < 2:
        done = 0
        for body, start, goal in todo:
            if deadline.expired():
                break
            report = service.plan(PathQuery(body, (start, goal), obstacles), deadline)
            done += report.outcome is Outcome.FOUND
        return done
    # dealt out like cards: neighbours in the list are often equally hard
    hands = [todo[i::processes] for i in range(min(processes, len(todo)))]
    found = _in_children(service, hands, obstacles, deadline)
    return sum(
        _store(service, pair, obstacles, legs)
        for hand, answers in zip(hands, found, strict=True)
        for pair, legs in zip(hand, answers, strict=True)
    )


def _distinct(service: MotionService, pairs: Iterable[Pair]) -> list[Pair]:
    seen, todo = set(), []
    for body, start, goal in pairs:
        ends = frozenset((tuple(start), tuple(goal)))
        if len(ends) == 2 and (body, ends) not in seen:
            seen.add((body, ends))
            todo.append((body, start, goal))
    return todo


def _in_children(
    service: MotionService,
    hands: Sequence[Sequence[Pair]],
    obstacles: tuple[Placed, ...],
    deadline: Deadline,
) -> list[list[tuple[str, Leg] | None]]:
    """Return the answers for each list of pairs, each list planned in a process of its own."""
    scope = (service.grid, service.planner, service.scene.margin, service.seed, service.tuning)
    jobs = [_pickled(_Job(*scope, tuple(h), obstacles, deadline.remaining())) for h in hands]
    with contextlib.ExitStack() as stack:
        running = []
        for job in jobs:
            answer = stack.enter_context(tempfile.TemporaryFile())
            errors = stack.enter_context(tempfile.TemporaryFile())
            process = subprocess.Popen(
                child.command(child.bare(__name__)),
                env=child.environment(),
                stdin=subprocess.PIPE,  # its end tells the child that this process is gone
                stdout=answer,
                stderr=errors,
                start_new_session=True,  # Ctrl-C is for this process, which ends the child
            )
            stack.callback(_end, process)
            assert process.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # why it died is told below
                process.stdin.write(len(job).to_bytes(8, "big") + job)
                process.stdin.flush()
            running.append((process, answer, errors))
        return [_answer(*one, deadline) for one in running]


def _pickled(job: _Job) -> bytes:
    try:
        return pickle.dumps(job, protocol=pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise UnsupportedError(
            f"a motion cannot be planned in another process ({error}); use processes=1"
        ) from error


def _answer(
    process: subprocess.Popen[bytes], answer: IO[bytes], errors: IO[bytes], deadline: Deadline
) -> list[tuple[str, Leg] | None]:
    limit = deadline.remaining() + _GRACE
    try:
        code = process.wait(None if limit == float("inf") else limit)
    except subprocess.TimeoutExpired:
        raise EngineError("a process that plans motions did not end by its deadline") from None
    if code != 0:
        errors.seek(0)
        said = errors.read().decode(errors="replace").strip().splitlines()
        raise EngineError(
            f"a process that plans motions died (exit status {code}): {said[-1] if said else ''}"
        )
    answer.seek(0)
    found: Any = pickle.load(answer)
    return list(found)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
    process.wait()
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()


def main() -> None:
    """Read a job from standard input, write its legs to standard output."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a planner prints is no answer
    with os.fdopen(os.dup(0), "rb") as stream:
        job: _Job = pickle.loads(stream.read(int.from_bytes(stream.read(8), "big")))
    child.die_with(sys.stdin.fileno())
    deadline = Deadline.after(None if job.seconds == float("inf") else job.seconds)
    service = MotionService(
        job.grid, planner=job.planner, margin=job.margin, seed=job.seed, tuning=job.tuning
    )
    with answers:
        pickle.dump([_plan(service, p, job.obstacles, deadline) for p in job.pairs], answers)


def _plan(
    service: MotionService, pair: Pair, obstacles: tuple[Placed, ...], deadline: Deadline
) -> tuple[str, Leg] | None:
    body, start, goal = pair
    if deadline.expired() or service.certificate(body, (start, goal), obstacles) is not None:
        return None
    found = service.legs.find(LegQuery(body, start, goal, obstacles), deadline)
    return None if found.leg is None else (found.planner, found.leg)


def _store(
    service: MotionService,
    pair: Pair,
    obstacles: tuple[Placed, ...],
    found: tuple[str, Leg] | None,
) -> int:
    if found is None:
        return 0
    name, leg = found
    service.remember(name, LegQuery(*pair, obstacles), leg)
    return 1
