"""Smaller protobuf messages for engines behind a server that refuses large ones."""

from __future__ import annotations

from typing import Any

from unified_planning.grpc.proto_writer import ProtobufWriter
from unified_planning.model.scheduling import SchedulingProblem

from up_samp.model import UnsupportedError


class SlimWriter:
    """Wraps UP's protobuf writer: a scheduling problem is measured against ``limit`` bytes.

    UP writes every base constraint twice (plain and scoped). Engines that read the plain ones get
    only those.
    """

    def __init__(self, writer: ProtobufWriter, limit: int):
        self._writer = writer
        self.limit = limit
        self._last: tuple[SchedulingProblem, Any] | None = None

    def convert(self, value: Any, *args: Any) -> Any:
        """Return the protobuf message.

        Raises:
            UnsupportedError: the message is larger than the limit.
        """
        if self._last is not None and self._last[0] is value:
            return self._last[1]
        message = self._writer.convert(value, *args)
        if isinstance(value, SchedulingProblem):
            del message.scheduling_extension.scoped_constraints[:]
            size = message.ByteSize()
            if size > self.limit:
                raise UnsupportedError(
                    f"a problem of {size:,} bytes after compilation: the engine's server takes at "
                    f"most {self.limit:,} bytes"
                )
            self._last = (value, message)
        return message


def slim_down(engine: Any, problem: SchedulingProblem, limit: int) -> None:
    """Make ``engine`` (one that keeps UP's writer in ``_writer``) send small messages, and write
    that for ``problem`` now: it takes a while that the engine does not count as its own time.
    """
    if not isinstance(engine._writer, SlimWriter):
        engine._writer = SlimWriter(engine._writer, limit)
    engine._writer.convert(problem)
