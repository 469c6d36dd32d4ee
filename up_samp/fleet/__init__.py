"""Problems in the words of those who have them: map, robots, places, doors, orders, tasks."""

from up_samp.fleet.faults import Fault, FleetError
from up_samp.fleet.files import read_problem_file, write_problem_file
from up_samp.fleet.fleet import Fleet, FleetResult

__all__ = [
    "Fault",
    "Fleet",
    "FleetError",
    "FleetResult",
    "read_problem_file",
    "write_problem_file",
]
