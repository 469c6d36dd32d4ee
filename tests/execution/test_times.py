"""The times that re-ordering decides by: CP-SAT against every combination of decisions."""

import itertools
from dataclasses import replace

from ortools.sat.python import cp_model

from tests.execution import floors
from up_samp.execution.build import dependencies_of
from up_samp.execution.executor import Executor, Go, Hold
from up_samp.execution.floor import Delays
from up_samp.execution.graph import At, Edge, Event, topological
from up_samp.execution.reorder import NOW, SCALE, WORTH, _solve, open_decisions, tied
from up_samp.execution.simulate import simulate
from up_samp.execution.state import TaskPhase


def plainly(times, chosen=()):
    """When each event happens with these decisions (``None``: they make a cycle)."""
    kept = [
        t for t in times.ties if t.only_if == 0 or chosen[abs(t.only_if) - 1] == (t.only_if > 0)
    ]
    pairs = [(t.first, t.then) for t in kept if t.first != NOW]
    at = [0] * len(times.number)
    order = topological(len(at), pairs, at)
    if len(order) < len(at):
        return None
    into = {}
    for tie in kept:
        into.setdefault(tie.then, []).append(tie)
    for k in order:
        for tie in into.get(k, ()):
            at[k] = max(at[k], tie.ticks + (0 if tie.first == NOW else at[tie.first]))
    return at


def test_no_combination_of_decisions_is_sooner(yaml):
    looked, better = 0, 0

    def watch(executor):
        nonlocal looked, better
        ahead = executor.retime()
        executor.horizon = 1000.0
        decisions = open_decisions(executor, ahead)[:5]
        if not decisions or executor.now % 4.0 > 1.0:
            return 0
        looked += 1
        times, ends = tied(executor, decisions)
        every = itertools.product((True, False), repeat=len(decisions))
        known = {chosen: at for chosen in every if (at := plainly(times, chosen)) is not None}
        found = {chosen: max(at[k] for k in ends) for chosen, at in known.items()}
        least = min(found.values())
        # the same times with variables left out
        model = cp_model.CpModel()
        literals = [model.new_bool_var("") for _ in decisions]
        at = times.variables(model, 10**6, literals)
        last = model.new_int_var(0, 10**6, "")
        for k in ends:
            model.add(last >= at[k])
        model.minimize(last)
        solver = cp_model.CpSolver()
        solver.parameters.num_workers = 1
        assert solver.solve(model) == cp_model.OPTIMAL
        assert round(solver.objective_value) == least
        chosen = _solve(executor, ahead, decisions)
        worth = least <= (ahead.makespan - WORTH - executor.now) * SCALE
        assert bool(chosen) == worth
        if chosen:
            better += 1
            assert found[tuple(chosen[d.key] for d in decisions)] == least
        return 0

    for seed in range(40, 46):
        problem, plan = floors.random_floor(seed, yaml)
        found = dependencies_of(problem, plan)
        late = Delays(slow=0.6, long_stop=25.0)
        run = simulate(found, plan, late, seed, policy="reorder", watch=watch, judged=False)
        assert run.finished
    assert looked >= 12
    assert better >= 2


def test_nobody_is_forecast_beyond_a_gate_before_it_opens(crossed):
    problem, plan, found = crossed
    (name,) = {m["activity"] for m in plan["motions"] if m["object"] == "r1"}
    graph = found.graph
    gates = [e for e in graph.events if e.at is At.LEAVE and e.activity == name]
    beyond = Event(At.REACH, name, "r1", max(e.progress for e in gates) + 0.1)
    end = Event(At.END, name)
    watched = replace(
        graph,
        events=(*graph.events, beyond),
        times=(*graph.times, graph.times[graph.number[end]]),
        edges=(*graph.edges, Edge(beyond, end, 0.0, "constraint", "watched")),
    )
    executor = Executor(plan, problem, dependencies=replace(found, graph=watched))
    executor.commands(20.0)  # both have begun, and r0 has not moved
    assert executor.phase(name) is TaskPhase.RUNNING
    ahead = executor.retime()
    for gate in gates:
        assert ahead.times[watched.number[gate]] < ahead.times[watched.number[beyond]]


def test_who_has_told_nothing_for_a_while_is_forecast_to_have_gone_on(crossed):
    problem, plan, found = crossed
    executor = Executor(plan, problem, dependencies=found)
    executor.commands(0.0)
    way = executor.state.of_object["r0"]
    told = way.travel.time_at(1.0)
    executor.update("r0", progress=1.0, now=told)
    before = executor.retime()
    ends = {Event(At.END, way.activity), *(e for e in found.graph.events if e.object == "r0")}
    ahead = {e: before.times[found.graph.number[e]] for e in ends}
    ahead = {e: time for e, time in ahead.items() if time > told + 1.0}
    assert ahead
    executor.commands(told + 1.0)
    after = executor.retime()
    assert {e: round(after.times[found.graph.number[e]], 6) for e in ahead} == {
        e: round(time, 6) for e, time in ahead.items()
    }
    times, _ = tied(executor, [])
    low = plainly(times)
    for event, number in times.number.items():
        if event in ahead and event.at is At.END:
            assert abs(low[number] / SCALE - (ahead[event] - executor.now)) < 0.05
    executor.update("r0", progress=1.0, now=executor.now)  # it stood
    assert executor.retime().span(way.activity)[1] > before.span(way.activity)[1] + 0.9


def test_who_waits_and_tells_to_be_a_little_beyond_still_waits(crossed):
    """Where robots tell to be is wrong by centimetres: with this one gone past its gate, as it
    seemed, another order looked better that nobody could follow, and none was changed.
    """
    problem, plan, _ = crossed
    error, ends = 0.05, []
    found = dependencies_of(problem, plan, localisation=error)
    for beyond in (0.0, 0.02, 0.04):
        executor = Executor(plan, problem, dependencies=found, localisation=error)
        executor.commands(20.0)  # both have begun, and r0 has not moved
        command = executor.commands(20.0)["r1"]
        assert isinstance(command, Go)
        executor.update("r1", progress=command.until + beyond, now=25.0)
        assert isinstance(executor.commands(25.0)["r1"], Hold)
        times, _ = tied(executor, [])
        ends.append(plainly(times)[times.number[Event(At.END, command.motion)]] / SCALE)
    assert max(ends) - min(ends) < 0.05
