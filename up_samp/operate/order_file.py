"""Orders by a file: what it lists is to be done, whatever it listed before."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from up_samp.fleet.faults import FleetError
from up_samp.fleet.files import compose, plain, text_of
from up_samp.fleet.records import Order, Task
from up_samp.model import SampError
from up_samp.operate.loop import Operation
from up_samp.operate.planner import each_time
from up_samp.operate.records import job_record

KEY = "orders of a file"


class OrderFile:
    """Orders and tasks of a YAML or JSON file, listed as in a problem file, and looked at again
    whenever it changes: what is new is added, what reads otherwise is changed, and what is gone is
    cancelled, all of it only where it has not begun.

    :raises FleetError: where it cannot be read.
    """

    def __init__(self, day: Operation, file: Path) -> None:
        self.day, self.file = day, file
        self._mine = set(day.store.day(KEY) or ())
        self._seen: tuple[int, int] | None = None
        self._taken: tuple[int, int] | None = None
        text_of(file)

    def look(self) -> list[str]:
        """Take over what has changed, once it is the same at two looks: a file that is written anew
        is empty first, or half there, and all else would be cancelled for good. Return what is
        refused, in words.
        """
        try:
            status = self.file.stat()
        except OSError:
            return []  # it is being written again
        seen = status.st_mtime_ns, status.st_size
        before, self._seen = self._seen, seen
        if seen == self._taken or seen != before:
            return []
        self._taken = seen
        try:
            records = [*_listed(self.file)]
        except FleetError as error:
            return [str(error)]
        refused: list[str] = []
        listed = {one.id for record in records for one in each_time(record)}
        for record in records:
            every = each_time(record)
            if any(one != getattr(self.day.jobs.get(one.id), "record", None) for one in every):
                refused += self._tried(self.day.add, record)
        for name in sorted(self._mine - listed):
            if name in self.day.jobs and self.day.jobs[name].state.open:
                refused += self._tried(self.day.cancel, name)
        self._mine = listed
        with self.day.store:
            self.day.store.keep(KEY, sorted(listed))
        return refused

    def _tried(self, do: Any, what: Any) -> Iterator[str]:
        try:
            do(what)
        except SampError as error:
            yield str(error)


def _listed(file: Path) -> Iterator[Order | Task]:
    """Yield the orders and tasks of a file: a list of them, or ``orders`` and ``tasks``.

    :raises FleetError: where it is no such file.
    """
    root = compose(file, text_of(file))
    data = [] if root is None else plain(file, root)
    if isinstance(data, dict) and not data.keys() - {"orders", "tasks"}:
        data = [*(data.get("orders") or ()), *(data.get("tasks") or ())]
    if not isinstance(data, list) or not all(isinstance(entry, dict) for entry in data):
        raise FleetError((), f"{file}: a list of orders and tasks is needed, as in a problem file")
    known: set[str] = set()
    for entry in data:
        record = job_record(entry)
        if record.id in known:
            raise FleetError((), f"{file}: '{record.id}' is listed twice")
        known.add(record.id)
        yield record
