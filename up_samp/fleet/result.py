"""What came of solving a fleet problem: the plan, its pictures, and why."""

from __future__ import annotations

import tempfile
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unified_planning.engines import PlanGenerationResult
from unified_planning.model.motion import SchedulingMotionProblem
from unified_planning.plans import Plan
from unified_planning.shortcuts import OneshotPlanner

from up_samp import plotting
from up_samp.engines.factory import engine_named
from up_samp.engines.registration import register
from up_samp.fleet.statements import Kind, Written
from up_samp.io import PlanDict, result_to_dict
from up_samp.io.sampling import in_formation
from up_samp.model import SampError
from up_samp.model.objective import MinimizeCosts
from up_samp.validation import terms_of

if TYPE_CHECKING:  # Matplotlib is slow to import
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class FleetResult:
    """A solver's answer to a problem. ``outcome`` is UP's own result."""

    written: Written
    outcome: PlanGenerationResult
    seconds_per_unit: float = 1.0
    check: Callable[[], Sequence[object]] = tuple
    """What a look at the problem finds; asked for where there is no plan."""
    tell: Callable[[PlanDict], list[str]] = lambda _: []
    """What else there is to say of a plan."""

    @property
    def problem(self) -> SchedulingMotionProblem:
        """The UP problem that was solved."""
        return self.written.problem

    @property
    def status(self) -> str:
        """The name of UP's status, such as ``SOLVED_OPTIMALLY``."""
        return str(self.outcome.status.name)

    @property
    def plan(self) -> Plan | None:
        """UP's plan, or None."""
        return self.outcome.plan

    @property
    def makespan(self) -> float:
        """When all is over, s.

        :raises SampError: where there is no plan.
        """
        return float(self.data["makespan"]) * self.seconds_per_unit

    @cached_property
    def costs(self) -> dict[str, float]:
        """What the plan costs by term, weighted, where the objective weighs several.

        :raises SampError: where there is no plan, or another objective.
        """
        if self.plan is None or not any(
            isinstance(m, MinimizeCosts) for m in self.problem.quality_metrics
        ):
            raise SampError("only a plan of an objective of several terms costs something by term")
        return {term: float(cost) for term, cost in terms_of(self.problem, self.plan).items()}

    @property
    def left_out(self) -> list[str]:
        """The ids of optional orders and tasks that are not done; each adds to the makespan."""
        done = self.written.happening(self.data["activities"])
        return [meaning.what for meaning, _ in done if meaning.kind is Kind.LEAVE]

    @cached_property
    def data(self) -> PlanDict:
        """The plan as a dictionary (docs/plan-format.md)."""
        if self.plan is None:
            raise SampError(f"there is no plan ({self.status}); explain() tells why")
        return result_to_dict(self.problem, self.outcome, seconds_per_unit=self.seconds_per_unit)

    def gantt(self, file: str | PathLike[str] | None = None) -> Axes:
        """Draw who does what when; with ``file``, save the picture there."""
        return saved(plotting.plot_gantt(self.data), file)

    def map(self, file: str | PathLike[str] | None = None) -> Axes:
        """Draw the paths on the map; with ``file``, save the picture there."""
        return saved(plotting.plot_map(self.data, places=plotting.places_of(self.problem)), file)

    def save(self, folder: str | PathLike[str]) -> list[Path]:
        """Write ``plan.json``, ``gantt.png``, ``map.png`` and ``animation.html``."""
        places = plotting.places_of(self.problem)
        return plotting.write_outputs(self.data, Path(folder), places=places)

    def show(self, folder: str | PathLike[str] | None = None, *, browser: bool = True) -> Path:
        """Write the animated page (to ``folder``, or a temporary one) and open it in a browser;
        return the page's file.
        """
        target = Path(folder or tempfile.mkdtemp(prefix="up-samp-"))
        target.mkdir(parents=True, exist_ok=True)
        file = target / "animation.html"
        places = plotting.places_of(self.problem)
        page = Path(plotting.write_html(self.data, file, places=places))
        if browser:
            webbrowser.open(page.resolve().as_uri())
        return page

    def explain(self) -> str:
        """Tell in words what came out, and why there is no plan if there is none."""
        messages = [m.message for m in self.outcome.log_messages or []]
        if self.plan is None:
            return "\n".join([f"no plan: {self.status}", *messages, *map(str, self.check())])
        metrics = self.outcome.metrics or {}
        unit = self.seconds_per_unit
        bound = float(metrics.get("lower_bound", 0)) * unit
        lines = [f"{self.status}: all is over after {self.makespan:g} s"]
        costly = [m for m in self.problem.quality_metrics if isinstance(m, MinimizeCosts)]
        if costly:
            told = ", ".join(f"{term} {cost:g}" for term, cost in self.costs.items())
            total = "" if costly[0].in_order else f" {sum(self.costs.values()):g}:"
            lines.append(f"it costs{total} {told}")
        if costly and not costly[0].in_order:  # else the messages tell the bounds
            least = metrics.get("value_bound", "-")
            lines += [] if least == "-" else [f"no plan costs less than {float(Fraction(least)):g}"]
        elif bound:
            kind = metrics.get("bound_kind", "")
            lines.append(f"no plan can take less than {bound:g} s ({kind})")
        wishes = any("reverse_cost" in thing for thing in self.data["objects"])
        if wishes and self.status != "SOLVED_OPTIMALLY":
            lines.append(
                "its robots prefer to drive ahead: with reverse_cost: 1 more can be proven"
            )
        if self.left_out:
            lines.append(f"left out, which counts in that: {', '.join(self.left_out)}")
        drives: dict[str, float] = {}
        for motion in (*self.data["motions"], *in_formation(self.data)):
            samples = motion["samples"]
            took = samples[-1][0] - samples[0][0]
            drives[motion["object"]] = drives.get(motion["object"], 0.0) + took
        lines += [f"{name} is on the way for {took:.0f} s" for name, took in drives.items()]
        return "\n".join([*lines, *self.tell(self.data), *messages])


def solve_problem(
    written: Written,
    timeout: float | None,
    params: Mapping[str, Any],
    check: Callable[[], Sequence[object]] = tuple,
    tell: Callable[[PlanDict], list[str]] = lambda _: [],
) -> FleetResult:
    """Solve a problem; ``params["engine"]`` names the scheduler (``cpsat`` if it is absent)."""
    register()
    rest = {k: v for k, v in params.items() if k != "engine"}
    name = f"samp-refine[{params.get('engine', 'cpsat')}]"
    problem = written.problem
    engine_named(name)
    problem.environment.credits_stream = None
    with OneshotPlanner(name=name, params=rest) as planner:
        outcome = planner.solve(problem, timeout=timeout)
    return FleetResult(written, outcome, float(rest.get("seconds_per_unit", 1.0)), check, tell)


def saved(ax: Axes, file: str | PathLike[str] | None) -> Axes:
    """Save a picture, if ``file`` names one; return its axes."""
    if file is not None:
        from up_samp.plotting.style import saved as save_figure

        save_figure(ax, Path(file))
    return ax
