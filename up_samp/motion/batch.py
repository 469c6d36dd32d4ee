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
from up_samp.motion.crew import Found, Scope, find_legs, store_legs
from up_samp.motion.protocol import LegQuery
from up_samp.motion.service import MotionService
from up_samp.system import child

Pair = tuple[Body, Configuration, Configuration]

_GRACE = 10.0
"""Time (s) that a child gets beyond the deadline, to start and to hand over what it has."""


@dataclass(frozen=True)
class _Job:
    """What a child is asked for: legs on one map, with the service's settings."""

    scope: Scope
    queries: tuple[LegQuery, ...]
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
    queries = [LegQuery(*pair, service.met_by(pair[0], obstacles)) for pair in todo]
    # dealt out like cards: neighbours in the list are often equally hard
    hands = [queries[i::processes] for i in range(min(processes, len(queries)))]
    answers = _in_children(service, hands, deadline)
    return sum(store_legs(service, h, found) for h, found in zip(hands, answers, strict=True))


def _distinct(service: MotionService, pairs: Iterable[Pair]) -> list[Pair]:
    seen, todo = set(), []
    for body, start, goal in pairs:
        ends = frozenset((tuple(start), tuple(goal)))
        if len(ends) == 2 and (body, ends) not in seen:
            seen.add((body, ends))
            todo.append((body, start, goal))
    return todo


def _in_children(
    service: MotionService, hands: Sequence[Sequence[LegQuery]], deadline: Deadline
) -> list[list[Found]]:
    """Return the answers for each list of queries, each list planned in a process of its own."""
    scope = Scope.of(service)
    jobs = [_pickled(_Job(scope, tuple(hand), deadline.remaining())) for hand in hands]
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
) -> list[Found]:
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
    with answers:
        pickle.dump(find_legs(job.scope.service(), job.queries, job.seconds), answers)
