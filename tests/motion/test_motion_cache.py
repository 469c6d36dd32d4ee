"""The motion cache on disk: whatever is in its files, or happens to them, a solve goes on."""

import hashlib
import io
import os
import tempfile

import numpy as np
import pytest

from tests.motion.oracle import RECTANGLE, ROBOT, box_map, car_faults, smallest_clearance
from up_samp.model import Body, Deadline, Kinematics, MotionModel, Outcome, PathQuery, Placed
from up_samp.motion import Leg, LegQuery, MotionCache, MotionService
from up_samp.motion.cache import SUFFIX

GRID = box_map(20, 10, [(9, 0, 10, 4), (9, 6, 10, 10)])
POSES = ((4.0, 3.0, 0.0), (16.0, 7.0, 1.0))
SLIDER = Body(RECTANGLE, Kinematics(MotionModel.SE2, 1.0, 1.5, 0.8, 0.7))


def plan(folder, body=ROBOT, grid=GRID):
    service = MotionService(grid, cache=MotionCache(folder))
    report = service.plan(PathQuery(body, POSES), Deadline.after(60))
    assert report.outcome is Outcome.FOUND
    assert report.complete
    return report.trajectory, service


def only_file(folder):
    (path,) = folder.iterdir()
    assert path.suffix == SUFFIX
    return path


def rewritten(path, change):
    """Change the arrays in a file, and give it a right checksum again."""
    _, _, data = path.read_bytes().partition(b"\n")
    with np.load(io.BytesIO(data)) as arrays:
        arrays = dict(arrays)
    change(arrays)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    data = buffer.getvalue()
    path.write_bytes(hashlib.sha256(data).hexdigest().encode() + b"\n" + data)


def broken(data):
    yield "empty", b""
    yield "text", b"damaged"
    for share in (0.1, 0.5, 0.99):
        yield f"cut at {share}", data[: int(len(data) * share)]
    for i in (70, len(data) // 2, len(data) - 5):
        yield f"byte {i}", data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :]
    stated = hashlib.sha256(b"not an archive").hexdigest().encode()
    yield "no archive", stated + b"\nnot an archive"


@pytest.mark.parametrize("body", [ROBOT, SLIDER])
def test_what_was_kept_is_used(tmp_path, body):
    first, _ = plan(tmp_path, body)
    again, service = plan(tmp_path, body)
    assert service.cache.hits == 1
    assert np.array_equal(first.poses, again.poses)
    turned = MotionService(GRID, cache=MotionCache(tmp_path))
    back = turned.plan(PathQuery(body, POSES[::-1]), Deadline.after(60))
    assert turned.cache.hits == 1
    assert back.trajectory.duration == pytest.approx(first.duration, rel=1e-12)


def test_damaged_files_are_not_used(tmp_path):
    first, _ = plan(tmp_path)
    path = only_file(tmp_path)
    data = path.read_bytes()
    for what, content in broken(data):
        path.write_bytes(content)
        found, service = plan(tmp_path)
        assert service.cache.hits == 0, what
        assert np.array_equal(found.poses, first.poses), what
        assert path.read_bytes()[:64] == data[:64], f"{what}: it is written anew"


def samples(change):
    def apply(arrays):
        rows = arrays["samples0"].copy()
        arrays["samples0"] = change(rows)

    return apply


def set_to(name, value):
    return lambda arrays: arrays.update({name: value})


def through_the_wall(rows):
    """Straight ahead, within all limits but for the wall."""
    start, goal = rows[0, 1:], rows[-1, 1:]
    times = np.linspace(0.0, 60.0, 1300)
    shares = 0.5 - 0.5 * np.cos(np.pi * times / 60.0)
    poses = start + shares[:, None] * (goal - start)
    return np.column_stack([times, poses])


WRONG = {
    "not a number": samples(lambda r: np.where(r == r[5, 1], np.nan, r)),
    "infinite": samples(lambda r: np.where(r == r[5, 1], np.inf, r)),
    "another shape": samples(lambda r: r[:, :2]),
    "one row": samples(lambda r: r[0]),
    "no rows": samples(lambda r: r[:0]),
    "times backwards": samples(lambda r: r[::-1]),
    "starts later": samples(lambda r: r + np.array([1.0, 0, 0, 0])),
    "elsewhere": samples(lambda r: r + np.array([0, 1e-3, 0, 0])),
    "twice as fast": samples(lambda r: r * np.array([0.5, 1, 1, 1])),
    "jumps": samples(lambda r: np.delete(r, slice(40, 80), axis=0)),
    "sideways": samples(lambda r: r + np.array([0, 0, 0, 1]) * np.sin(r[:, :1])),
    "through the wall": samples(through_the_wall),
    "no obstacles' list": set_to("among0", "["),
    "obstacles as code": set_to("among0", "__import__('os').getcwd()"),
    "deeply nested": set_to("among0", "(" * 100_000),
    "count": set_to("count", np.array(3)),
    "search": set_to("search0", np.array([1.0])),
    "objects": set_to("samples0", np.array(["x"])),
}


@pytest.mark.parametrize("body", [ROBOT, SLIDER])
@pytest.mark.parametrize("what", WRONG)
def test_wrong_but_well_formed_files_are_not_used(tmp_path, what, body):
    first, _ = plan(tmp_path, body)
    rewritten(only_file(tmp_path), WRONG[what])
    found, service = plan(tmp_path, body)
    if what in ("sideways", "through the wall") and body is SLIDER:
        assert smallest_clearance(found, body, GRID) > 0
        return
    assert service.cache.hits == 0
    assert np.array_equal(found.poses, first.poses)
    _, service = plan(tmp_path, body)
    assert service.cache.hits == 1, "the right one has taken its place"


def test_a_leg_among_obstacles_is_checked_against_them(tmp_path):
    service = MotionService(GRID, cache=MotionCache(tmp_path))
    free = service.plan(PathQuery(ROBOT, POSES), Deadline.after(60)).trajectory
    small = Body(((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)), ROBOT.kinematics)
    parked = Placed("p", small, tuple(map(float, free.poses[len(free.poses) // 4])))
    service.legs.remember("car", LegQuery(ROBOT, *POSES, (parked,)), Leg(free, complete=True))
    again = MotionService(GRID, cache=MotionCache(tmp_path))
    report = again.plan(PathQuery(ROBOT, POSES, (parked,)), Deadline.after(60))
    assert report.outcome is Outcome.FOUND
    assert smallest_clearance(report.trajectory, ROBOT, GRID, (parked,)) > 0


def test_a_folder_that_cannot_be_written_to(tmp_path, monkeypatch, caplog):
    def refused(*_, **__):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(tempfile, "mkstemp", refused)
    found, _ = plan(tmp_path / "cache")
    assert car_faults(found, ROBOT.kinematics) == []
    assert any("Read-only" in r.message for r in caplog.records)


def test_a_full_disk_ends_the_writing_and_nothing_else(tmp_path, monkeypatch, caplog):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    service = MotionService(GRID, cache=MotionCache(tmp_path))
    for goal in (POSES[1], (16.0, 3.0, 0.0)):
        report = service.plan(PathQuery(ROBOT, (POSES[0], goal)), Deadline.after(60))
        assert report.outcome is Outcome.FOUND
    assert list(tmp_path.iterdir()) == [], "nothing half-written is left"
    assert len([r for r in caplog.records if "not kept" in r.message]) == 1


def test_a_file_in_place_of_the_folder(tmp_path):
    place = tmp_path / "cache"
    place.write_text("a file")
    found, _ = plan(place)
    assert found.duration > 0


def test_a_truncated_leg_gives_way_to_a_finished_one(tmp_path):
    best, _ = plan(tmp_path)
    slow = type(best)(best.times * 2.0, best.poses.copy())
    other = MotionService(GRID, cache=MotionCache())
    query = LegQuery(ROBOT, *POSES)
    other.legs.remember("car", query, Leg(slow, complete=False), limit=1.0)
    soon = other.plan(PathQuery(ROBOT, POSES), Deadline.after(1.0))
    assert soon.trajectory.duration == pytest.approx(slow.duration)
    assert not soon.complete
    later = other.plan(PathQuery(ROBOT, POSES), Deadline.after(60))
    assert later.complete
    assert later.trajectory.duration == pytest.approx(best.duration)
    # and what is finished is not replaced by what is not
    other.legs.remember("car", query, Leg(best, complete=False), limit=1.0)
    assert other.plan(PathQuery(ROBOT, POSES), Deadline.after(60)).complete
