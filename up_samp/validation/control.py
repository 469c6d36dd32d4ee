"""Control models: does a trajectory follow ``qdot = f(q, u)`` with some admissible control?"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from up_samp.model import ProblemError, UnsupportedError
from up_samp.model.arrays import FloatArray
from up_samp.model.violation import Violation
from up_samp.validation.limits import Limits
from up_samp.validation.tolerances import TOLERANCES
from up_samp.validation.tracks import Pieces


def breaks_law(
    what: str, limits: Limits, times: FloatArray, poses: FloatArray, pieces: Pieces
) -> Iterator[Violation]:
    """Yield a violation for the piece that admissible controls explain worst.

    In the middle of each piece the body's rate (constant twist) is compared with the nearest one
    that the model has for a control within its bounds, by Gauss-Newton steps projected on
    the bounds. Models whose state is not (x, y, theta) are unsupported.
    """
    middle = poses[:-1, 2] + pieces.turn / 2
    rates = np.column_stack(
        (
            (pieces.along * np.cos(middle) - pieces.across * np.sin(middle)) / pieces.dt,
            (pieces.along * np.sin(middle) + pieces.across * np.cos(middle)) / pieces.dt,
            pieces.turn / pieces.dt,
        )
    )
    worst, where = 0.0, 0
    control = np.array([(low + high) / 2 for low, high in limits.controls])
    for i, rate in enumerate(rates):
        half = (poses[i] + poses[i + 1]) / 2
        state = np.array([half[0], half[1], middle[i]])
        miss, control = _nearest(limits, state, rate, control)
        excess = miss - TOLERANCES.control_rate * float(np.abs(rate).max()) - 1e-3
        if excess > worst:
            worst, where = excess, i
    if worst > 0:
        text = f"{what}: no admissible control gives its motion at {times[where]:.3f} s"
        yield Violation("control", f"{text} (off by {worst:.3g})")


def _nearest(
    limits: Limits, state: FloatArray, rate: FloatArray, guess: FloatArray
) -> tuple[float, FloatArray]:
    """Return how near the model's rates come to ``rate``, and the control that does it."""
    low = np.array([c[0] for c in limits.controls])
    high = np.array([c[1] for c in limits.controls])
    best, best_control = math.inf, guess
    for start in (guess, (low + high) / 2, low, high):
        control = start.copy()
        for _ in range(12):
            value = _rate(limits, state, control)
            miss = float(np.linalg.norm(value - rate))
            if miss < best:
                best, best_control = miss, control.copy()
            if miss < 1e-9:
                break
            slope = _slope(limits, state, control, value)
            step = np.linalg.lstsq(slope, rate - value, rcond=None)[0]
            control = np.clip(control + step, low, high)
        if best < 1e-6:
            break
    return best, best_control


def _rate(limits: Limits, state: FloatArray, control: FloatArray) -> FloatArray:
    rate = np.zeros(3)
    assert limits.law is not None
    try:
        limits.law(state, control, rate)
    except (IndexError, TypeError) as error:
        raise UnsupportedError(
            f"object {limits.name}: its control model does not take (x, y, theta) and "
            f"{len(control)} controls: {error}"
        ) from error
    except Exception as error:  # a user's code may raise anything
        raise ProblemError(
            f"object {limits.name}: its control model raised {type(error).__name__}: {error}"
        ) from error
    return rate


def _slope(limits: Limits, state: FloatArray, control: FloatArray, value: FloatArray) -> FloatArray:
    """Return the derivative of the rates by the controls, shape (3, m), by differences."""
    columns = []
    for k in range(len(control)):
        moved = control.copy()
        moved[k] += 1e-6
        columns.append((_rate(limits, state, moved) - value) / 1e-6)
    return np.column_stack(columns)
