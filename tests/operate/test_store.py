"""What is in the store is there as a whole, however a process ends; one writes to it at a time."""

import sqlite3

import pytest

from up_samp.execution.reports import Report
from up_samp.operate.records import DayOrder, OrderState, job_record
from up_samp.operate.store import MIGRATIONS, Store, StoreError

ORDER = {"id": "o1", "pickup": "shelf", "delivery": "dock", "due": 30.0}


def test_what_is_kept_comes_back(tmp_path):
    store = Store(tmp_path / "day.db")
    job = DayOrder(job_record(ORDER), 1.5, OrderState.BEGUN, "r1", 4.0)
    with store:
        store.put_job(job)
        store.note(2.0, "told", "r1", "hold", "by hand")
        store.put_plan(3, 2.0, 1.0, {"a": [1, 2]})
        store.put_report(Report("r1", 2.0, "move", 0.5))
        store.put_snapshot(3, {"now": 2.0})
        store.put_report(Report("r1", 3.0, "move", pose=(1.0, 2.0, 0.0)))
    store.close()
    again = Store(tmp_path / "day.db")
    assert again.jobs() == {"o1": job}
    assert again.plan(3) == (1.0, {"a": [1, 2]})
    assert again.last_plan() == 3
    number, saved, reports = again.snapshot()
    assert (number, saved) == (3, {"now": 2.0})
    assert reports == [Report("r1", 3.0, "move", pose=(1.0, 2.0, 0.0))]
    assert again.notes("r1") == [(2.0, "told", "r1", "hold", "by hand")]
    again.close()


def test_what_fails_leaves_nothing(tmp_path):
    store = Store(tmp_path / "day.db")
    store.__enter__()
    store.note(1.0, "told", "r1", "hold")
    store.__exit__(ZeroDivisionError)
    assert store.notes() == []
    store.close()


def test_a_second_writer_is_refused_and_readers_are_not(tmp_path):
    store = Store(tmp_path / "day.db")
    with pytest.raises(StoreError, match="operated by another process"):
        Store(tmp_path / "day.db")
    reader = Store(tmp_path / "day.db", write=False)
    assert reader.jobs() == {}
    reader.close()
    store.close()
    Store(tmp_path / "day.db").close()


def test_later_versions_and_other_files_are_refused(tmp_path):
    base = sqlite3.connect(tmp_path / "later.db")
    base.execute(f"PRAGMA user_version = {len(MIGRATIONS) + 1}")
    base.close()
    with pytest.raises(StoreError, match="later version"):
        Store(tmp_path / "later.db")
    (tmp_path / "other.db").write_text("no database at all, but long enough to look like one " * 9)
    with pytest.raises(StoreError, match="no store"):
        Store(tmp_path / "other.db")
    with pytest.raises(StoreError, match="there is no store"):
        Store(tmp_path / "none.db", write=False)
