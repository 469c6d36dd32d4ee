"""What expressions and intervals say, each alone."""

from fractions import Fraction
from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st
from unified_planning.engines import LogLevel, LogMessage
from unified_planning.environment import get_environment
from unified_planning.model.timing import DurationInterval

from up_samp.upio.expressions import whole_bounds
from up_samp.upio.plan import words_told

BOUND = st.fractions(min_value=0, max_value=6, max_denominator=4)


@given(BOUND, BOUND, st.booleans(), st.booleans())
def test_whole_durations_are_those_that_an_interval_holds(low, high, left, right):
    real = get_environment().expression_manager.Real
    least, most = whole_bounds(DurationInterval(real(low), real(high), left, right))
    for length in range(-1, 9):
        after = low < length if left else low <= length
        before = length < high if right else length <= high
        assert (least <= length <= most) == (after and before)


def test_a_bound_that_is_no_constant_is_not_told():
    manager = get_environment().expression_manager
    more = manager.Plus(manager.Int(2), manager.Real(Fraction(1, 2)))
    lasts = DurationInterval(more, manager.Int(7), is_right_open=True)
    assert whole_bounds(lasts) == (None, 6)


def test_what_an_engine_says_is_told_be_it_a_message_or_an_error():
    said = [LogMessage(LogLevel.INFO, "one"), NotImplementedError("two")]
    assert words_told(SimpleNamespace(log_messages=said)) == ["one", repr(said[1])]
    assert words_told(SimpleNamespace(log_messages=said[1])) == [repr(said[1])]
    assert words_told(SimpleNamespace(log_messages=None)) == []
