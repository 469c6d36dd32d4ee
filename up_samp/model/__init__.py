"""The frozen values that the packages talk in. Imports nothing of ours, no UP, no OMPL."""

from up_samp.model.bodies import (
    Body,
    Configuration,
    ControlLaw,
    Kinematics,
    Mobility,
    MotionModel,
    Movable,
    Placed,
    TrafficZone,
    same_pose,
    stays,
)
from up_samp.model.deadline import Deadline, check_time, in_force
from up_samp.model.errors import (
    EngineError,
    OutOfTimeError,
    ProblemError,
    SampError,
    UnsupportedError,
)
from up_samp.model.motion import (
    GroupQuery,
    GroupReport,
    Outcome,
    PathQuery,
    PathReport,
    Rest,
    TimedMotion,
    Trajectory,
    avoids,
    interpolate,
)
from up_samp.model.objective import MetricMeaning
from up_samp.model.schedule import (
    CandidateSchedule,
    ScheduledChange,
    ScheduledMotion,
    ScheduleReport,
    ScheduleStatus,
)
from up_samp.model.violation import Violation

__all__ = [
    "Body",
    "CandidateSchedule",
    "Configuration",
    "ControlLaw",
    "Deadline",
    "EngineError",
    "GroupQuery",
    "GroupReport",
    "Kinematics",
    "MetricMeaning",
    "Mobility",
    "MotionModel",
    "Movable",
    "OutOfTimeError",
    "Outcome",
    "PathQuery",
    "PathReport",
    "Placed",
    "ProblemError",
    "Rest",
    "SampError",
    "ScheduleReport",
    "ScheduleStatus",
    "ScheduledChange",
    "ScheduledMotion",
    "TimedMotion",
    "TrafficZone",
    "Trajectory",
    "UnsupportedError",
    "Violation",
    "avoids",
    "check_time",
    "in_force",
    "interpolate",
    "same_pose",
    "stays",
]
