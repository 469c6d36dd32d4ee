"""Each rule rejects the schedule it comes from, and only schedules like it."""

import pytest

from up_samp.model import CandidateSchedule, ScheduledMotion
from up_samp.model.refinement import Layer, Requires, Strength
from up_samp.refinement import rules


def motion(name, start, end, obj=None):
    return ScheduledMotion(
        name, 0, obj or f"robot_{name}", ("p", "q"), ((0, 0, 0), (1, 0, 0)), start, end
    )


def schedule(**times):
    return CandidateSchedule(times)


def nowhere(*_):
    return {"somewhere"}


def at(**where):
    return lambda name, *_: {where[name]}


def test_blocked_while_gives_way_to_movement():
    cut = rules.blocked_while("a", {"box": "mid"}, {"box": ["push", "a"]}, "in the way")
    assert cut.strength is Strength.PROVEN
    assert not cut.statement.holds(schedule(a=(0, 5)), at(box="mid"))
    assert cut.statement.holds(schedule(a=(0, 5)), at(box="side"))
    assert cut.statement.holds(schedule(a=(0, 5), push=(4, 8)), at(box="mid"))
    assert not cut.statement.holds(schedule(a=(0, 5), push=(7, 8)), at(box="mid"))
    assert cut.statement.holds(schedule(push=(7, 8)), at(box="mid"))


def test_slower_while_asks_for_time_or_movement():
    cut = rules.slower_while("a", 8, {"box": "mid"}, {"box": ["push"]}, "around it").statement
    assert not cut.holds(schedule(a=(0, 5)), at(box="mid"))
    assert cut.holds(schedule(a=(0, 8)), at(box="mid"))
    assert cut.holds(schedule(a=(0, 5)), at(box="side"))


@pytest.mark.parametrize("shift", range(-3, 4))
def test_group_timing_rejects_just_its_offsets(shift):
    group = [motion("a", 0, 5), motion("b", 1, 6), motion("c", 2, 7)]
    cut = rules.group_timing(group, {"c": 9}, {}, {}, "late").statement
    moved = schedule(a=(0, 5), b=(1 + shift, 6 + shift), c=(2, 7))
    assert cut.holds(moved, nowhere) == (shift != 0)
    # starting later does not make the only late one arrive earlier
    later = schedule(a=(0, 5), b=(1, 6), c=(2 + abs(shift), 8))
    assert not cut.holds(later, nowhere)
    assert cut.holds(schedule(a=(0, 5), b=(1, 6), c=(2, 9)), nowhere)


def test_group_failure_is_heuristic_and_narrow():
    group = [motion("a", 0, 5), motion("b", 1, 6)]
    cut = rules.group_fails(group, {}, {}, "nothing found")
    assert cut.strength is Strength.HEURISTIC
    assert not cut.statement.holds(schedule(a=(0, 5), b=(1, 6)), nowhere)
    assert cut.statement.holds(schedule(a=(0, 5), b=(1, 7)), nowhere)
    assert cut.statement.holds(schedule(a=(0, 5), b=(2, 6)), nowhere)


def test_unary_place_counts_who_is_there():
    place = rules.unary_place("m", ["in1", "in2"], ["out1"], taken=False)
    assert place.layer is Layer.BOUND
    assert place.statement.holds(schedule(in1=(0, 5), out1=(7, 9), in2=(3, 8)), nowhere)
    assert not place.statement.holds(schedule(in1=(0, 5), out1=(9, 12), in2=(3, 8)), nowhere)
    assert not place.statement.holds(schedule(in1=(0, 5), in2=(3, 8)), nowhere)
    assert not place.statement.holds(schedule(in1=(0, 5), out1=(8, 9), in2=(3, 8)), nowhere)


def test_nobody_passes_through_a_unary_place_where_another_rests():
    place = rules.unary_place("m", ["in1", "in2"], ["out1", "out2"], taken=False)
    first = {"in1": (0, 16), "out1": (18, 30)}
    assert not place.statement.holds(schedule(**first, in2=(0, 17), out2=(17, 28)), nowhere)
    assert place.statement.holds(schedule(**first, in2=(0, 15), out2=(15, 28)), nowhere)
    assert place.statement.holds(schedule(**first, in2=(0, 19), out2=(19, 28)), nowhere)
    assert not place.statement.holds(schedule(**first, in2=(0, 16), out2=(16, 28)), nowhere)


def test_a_parameter_may_tell_who_comes_to_a_unary_place_and_leaves_it():
    goes = [("go1", "go1.to", "m"), ("go2", "go2.to", "m")]
    leaves = [("go1", "go1.source", "m"), ("go2", "go2.source", "m")]
    place = rules.unary_place("m", [], [], False, leaves, goes).statement

    def told(**parameters):
        values = {f"{k[:3]}.{k[4:]}": v for k, v in parameters.items()}
        return CandidateSchedule({"go1": (0, 5), "go2": (3, 8)}, values)

    assert not place.holds(told(go1_to="m", go2_to="m"), nowhere)
    assert place.holds(told(go1_to="m", go2_to="n"), nowhere)
    assert place.holds(told(go1_to="n", go2_to="m"), nowhere)
    taken = rules.unary_place("m", [], [], True, leaves, goes).statement
    assert not taken.holds(told(go1_source="n", go2_to="m"), nowhere)
    assert taken.holds(told(go1_source="m", go2_to="m"), nowhere)


def test_requirements_at_the_end():
    tail = Requires("a", "door", "shut", at_end=True)

    def opened_at(t):
        return lambda _, first, last: (
            ({"shut"} if first <= t else set()) | ({"open"} if last >= t + 1 else set())
        )

    assert tail.holds(schedule(a=(0, 10)), opened_at(9))
    assert not tail.holds(schedule(a=(0, 10)), opened_at(10))


def test_the_papers_condition_gives_way_to_any_rival():
    group = [motion("a", 0, 5)]
    cut = rules.paper_geometric(group, ["a", "r"], {"box": "mid"})
    assert not cut.holds(schedule(a=(0, 5)), at(box="mid"))
    assert not cut.holds(schedule(a=(0, 5), r=(6, 8)), at(box="mid"))
    assert cut.holds(schedule(a=(0, 5), r=(5, 8)), at(box="mid"))
    assert cut.holds(schedule(a=(0, 5)), at(box="side"))


def test_the_papers_timing_cut():
    group = [motion("a", 0, 5), motion("b", 2, 6)]
    cut = rules.paper_temporal(group, ["a", "b"], {"b": 8}, {})
    assert not cut.holds(schedule(a=(0, 5), b=(2, 6)), nowhere)
    assert cut.holds(schedule(a=(0, 5), b=(1, 6)), nowhere)
    assert cut.holds(schedule(a=(0, 5), b=(2, 8)), nowhere)


def test_a_ride_clears_the_way_when_it_starts():
    """A change of an obstacle clears it at its end, a ride at its start."""
    made = motion("a", 5, 9)
    cuts = {
        rides: rules.blocked_as_timed(
            made, {"box": "bring"}, {"box": {"bring": 5, "away": -1}}, "in the way", rides=rides
        ).statement
        for rides in (frozenset(), frozenset({"away"}))
    }
    for start in range(5, 12):
        times = schedule(bring=(0, 5), a=(5, 9), away=(start, start + 3))
        assert cuts[frozenset({"away"})].holds(times, nowhere) == (start < 9)
        assert cuts[frozenset()].holds(times, nowhere) == (start + 3 < 9)


def test_nothing_is_set_onto_what_rests_until_it_has_gone():
    """Set elsewhere in that instant, it has gone; driving off then, it has not."""
    moves, sets = {"drive": None}, {"lift": (0, 9)}
    cut = rules.set_onto("shut", None, moves, sets, "on it")
    assert cut.strength is Strength.PROVEN
    assert not cut.statement.holds(schedule(shut=(0, 8), lift=(0, 9)), nowhere)
    assert cut.statement.holds(schedule(shut=(0, 9), lift=(0, 9)), nowhere)
    assert not cut.statement.holds(schedule(shut=(0, 9), drive=(9, 12)), nowhere)
    assert cut.statement.holds(schedule(shut=(0, 9), drive=(8, 12)), nowhere)
