"""A day on the floor: orders come in, robots are late or break, and what is left is planned again
and again while the rest is driven. See docs/operate.md; no function of it is safety-rated.
"""

from up_samp.execution.reports import Report
from up_samp.operate.clock import RealClock, SimulatedClock
from up_samp.operate.loop import Operation
from up_samp.operate.records import DayOrder, OrderState, Settings
from up_samp.operate.store import Store, StoreError

__all__ = [
    "DayOrder",
    "Operation",
    "OrderState",
    "RealClock",
    "Report",
    "Settings",
    "SimulatedClock",
    "Store",
    "StoreError",
]
