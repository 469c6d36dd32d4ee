"""Orders for robots: valid by the published schemas, and safe to follow in any tempo."""

import itertools
import json
import math
import random
from pathlib import Path

import numpy as np
import pytest
import yaml
from unified_planning.shortcuts import GE, OneshotPlanner

from tests.execution import floors
from tests.export.plans import door_plan
from tests.fuzz.problems import SECONDS, build, random_case
from tests.usual import usually
from up_samp import Fleet
from up_samp.cli import main
from up_samp.execution import with_dependencies
from up_samp.execution.files import event_from_list
from up_samp.execution.graph import ORIGIN, At, Event
from up_samp.export import export_plan
from up_samp.export.mcap_file import DEFINITIONS
from up_samp.export.steps import steps_of
from up_samp.export.vda5050 import file_names, nurbs
from up_samp.geometry.maps import write_map
from up_samp.io import result_to_dict, write_plan
from up_samp.model import ProblemError

SCHEMAS = Path(__file__).parents[3] / "shared" / "data" / "vda5050"
SEEDS = (101, 104, 113, 120)
"""Small problems with two robots or more whose plans have dependencies."""


PLANS = [*SEEDS, "together"]
FEWER = pytest.mark.parametrize("plan", usually(*SEEDS, of=PLANS), indirect=True)


@pytest.fixture(scope="module", params=PLANS)
def plan(request, tmp_path_factory):
    if request.param == "together":
        return together(tmp_path_factory.mktemp("floor"))
    problem = build(random_case(request.param), tmp_path_factory.mktemp("floor"))
    params = {"seconds_per_unit": SECONDS}
    with OneshotPlanner(name="samp-refine[cpsat]", params=params) as planner:
        result = planner.solve(problem, timeout=20.0)
    if result.plan is None:
        pytest.skip(f"no plan ({result.status.name})")
    return with_dependencies(problem, result_to_dict(problem, result))


def together(folder):
    """Two robots that pick two loads up at the same time: they wait for each other to do so."""
    cells = np.zeros((100, 160), dtype=bool)
    cells[:2], cells[-2:], cells[:, :2], cells[:, -2:] = True, True, True, True
    fleet = Fleet(write_map(folder, "hall", cells, 0.1), name="together")
    fleet.add_robot_type("agv", (0.8, 0.6), model="diff")
    for k, others in enumerate(("", "o0")):
        for name, x in (("home", 2), ("rack", 6), ("dock", 13)):
            fleet.add_place(f"{name}{k}", x, 2 + 3 * k)
        fleet.add_robot(f"r{k}", "agv", f"home{k}", end=f"home{k}")
        fleet.add_order(f"o{k}", f"rack{k}", f"dock{k}", together=others or ())
    fleet.add_order("later", {"at": "rack1", "service": 4}, "dock0", after="o0")
    result = fleet.solve(first_plan=True)
    return with_dependencies(fleet.problem, result.data)


def read(path):
    return json.loads(path.read_text())


def messages_of(folder):
    releases = read(folder / "releases.json")
    return [(m, read(folder / m["file"])) for m in releases["messages"]]


@pytest.mark.parametrize(
    ("form", "schema"), [("vda5050", "2.1.0"), ("vda5050-3", "main")], ids=["2.1", "3.0"]
)
def test_every_message_obeys_the_published_schema(plan, tmp_path, form, schema):
    jsonschema = pytest.importorskip("jsonschema")
    file = SCHEMAS / schema / "order.schema"
    if not file.exists():
        pytest.skip("the schemas of VDA 5050 are not beside the project")
    export_plan(plan, form, tmp_path)
    validator = jsonschema.Draft202012Validator(read(file))
    for _, message in messages_of(tmp_path):
        validator.validate(message)
        known = {"maximumSpeed", "maxSpeed", "length", "trajectory"}
        assert all(known & set(edge) for edge in message["edges"])


def test_an_order_grows_from_update_to_update(plan, tmp_path):
    export_plan(plan, "vda5050", tmp_path)
    last: dict[str, tuple[int, int]] = {}
    orders: dict[str, list[str]] = {}
    ended: dict[str, dict] = {}
    for entry, message in messages_of(tmp_path):
        robot = entry["serialNumber"]
        nodes, edges = message["nodes"], message["edges"]
        assert [n["sequenceId"] for n in nodes] == list(
            range(nodes[0]["sequenceId"], nodes[-1]["sequenceId"] + 1, 2)
        )
        for a, edge, b in zip(nodes, edges, nodes[1:], strict=False):
            assert (edge["startNodeId"], edge["endNodeId"]) == (a["nodeId"], b["nodeId"])
            assert edge["sequenceId"] == a["sequenceId"] + 1
        flags = [x["released"] for pair in itertools.zip_longest(nodes, edges) for x in pair if x]
        assert flags == sorted(flags, reverse=True), "nothing is released after a gap"
        order = message["orderId"]
        if order not in orders.setdefault(robot, []):
            if orders[robot]:  # where the one before ended
                assert nodes[0]["nodeId"] == ended[robot]["nodeId"]
                assert nodes[0]["nodePosition"] == ended[robot]["nodePosition"]
            orders[robot].append(order)
            last.pop(robot, None)
        assert order == orders[robot][-1]
        ended[robot] = nodes[-1]
        number, stitched = last.get(robot, (-1, 0))
        assert message["orderUpdateId"] == number + 1
        assert nodes[0]["sequenceId"] == stitched
        base = max(n["sequenceId"] for n in nodes if n["released"])
        last[robot] = (number + 1, base)
        assert nodes[-1]["released"] or base < nodes[-1]["sequenceId"]
    for robot, (_, base) in last.items():
        assert base == ended[robot]["sequenceId"], f"{robot} is never released to its end"


def whole_orders(folder, robot):
    """The first message of each of a robot's orders, which tells all its nodes, in turn."""
    own = [m for e, m in messages_of(folder) if e["serialNumber"] == robot]
    return [m for m in own if m["orderUpdateId"] == 0]


def test_for_what_waits_an_order_of_its_own_begins(plan, tmp_path):
    export_plan(plan, "vda5050", tmp_path)
    waited = 0
    for robot, steps in steps_of(plan).items():
        orders = whole_orders(tmp_path, robot) if robot else []
        waiting = [s for s in steps[1:] if s.piece is None and s.waits]
        assert len(orders) == (1 + len(waiting) if robot else 0)
        waited += len(waiting)
        assert all(e["length"] > 0 or "rotationAllowed" in e for m in orders for e in m["edges"])
        actions = [a["actionType"] for m in orders for n in m["nodes"] for a in n["actions"]]
        assert actions == [s.activity for s in steps if s.piece is None][: len(actions)]
        for message, step in zip(orders[1:], waiting, strict=True):
            assert message["nodes"][0]["actions"][0]["actionType"] == step.activity
        most = next((o["v_max"] for o in plan["objects"] if o["name"] == robot), 0.0)
        assert all(e.get("maxSpeed", 0.0) <= most for m in orders for e in m["edges"])
    assert waited > 0 or plan["problem"] != "together"


def test_no_order_comes_before_the_one_before_is_over(plan, tmp_path):
    """A robot refuses another order while it has nodes to come to, or something to do."""
    export_plan(plan, "vda5050", tmp_path)
    before: dict[str, dict] = {}
    for entry, message in messages_of(tmp_path):
        robot = entry["serialNumber"]
        other = before.get(robot, message)
        if other["orderId"] != message["orderId"]:
            last = other["nodes"][-1]
            signs = [sign for condition in entry["after"] for sign in condition["seen"]]
            mine = [
                x for x in signs if (x["serialNumber"], x["orderId"]) == (robot, other["orderId"])
            ]
            done = [a["actionId"] for a in last["actions"]]
            assert any(
                x.get("actionStatus") == "FINISHED" and x["actionId"] == done[-1]
                if done
                else x.get("lastNodeSequenceId") == last["sequenceId"]
                for x in mine
            )
        before[robot] = message


def test_the_robots_drive_what_the_plan_says(plan, tmp_path):
    """Joined, the edges of its orders are the robot's way, within a centimetre."""
    export_plan(plan, "vda5050", tmp_path)
    for robot in {e["serialNumber"] for e, _ in messages_of(tmp_path)}:
        driven = [np.asarray(m["samples"])[:, 1:3] for m in plan["motions"] if m["object"] == robot]
        told = [
            np.array([[c["x"], c["y"]] for c in e["trajectory"]["controlPoints"]])
            for message in whole_orders(tmp_path, robot)
            for e in message["edges"]
            if "trajectory" in e
        ]
        assert np.allclose(told[0][0], driven[0][0], atol=1e-5)
        assert np.allclose(told[-1][-1], driven[-1][-1], atol=1e-5)
        for a, b in itertools.pairwise(told):
            assert np.allclose(a[-1], b[0], atol=1e-3)
        for point in np.vstack(driven)[::5]:
            assert min(_gap(point, t) for t in told) < 0.02


def _gap(point, line):
    gaps = [float(np.hypot(*(point - line[0])))]
    for a, b in itertools.pairwise(line):
        span = max(float((b - a) @ (b - a)), 1e-300)
        foot = a + np.clip((point - a) @ (b - a) / span, 0, 1) * (b - a)
        gaps.append(float(np.hypot(*(point - foot))))
    return min(gaps)


def test_no_step_begins_before_what_it_depends_on(plan):
    """Follow the steps as late as each robot likes: every dependency of the plan holds."""
    steps = steps_of(plan)
    for seed in range(20):
        when = follow(steps, np.random.default_rng(seed))
        assert when is not None, "the steps wait for each other"
        for edge in plan["dependencies"]["edges"]:
            first, then = event_from_list(edge["first"]), event_from_list(edge["then"])
            if first in when and then in when:
                early = when[then] - when[first] - edge["lag"]
                assert early > -5e-3, edge


def follow(steps, random):
    """Return when each event happens if robots take 1 to 3 times as long as planned."""
    when = {ORIGIN: 0.0}
    clock = dict.fromkeys(steps, 0.0)
    todo = {robot: list(own) for robot, own in steps.items()}
    while any(todo.values()):
        moved = False
        for robot, own in todo.items():
            if not own or any(w.event not in when for w in own[0].waits):
                continue
            step = own.pop(0)
            ready = [when[w.event] + w.lag for w in step.waits]
            begin = max([clock[robot], *ready])
            planned = step.seconds
            if step.piece is not None:
                planned = float(step.piece.rows[-1, 0] - step.piece.rows[0, 0])
            clock[robot] = begin + planned * random.uniform(1.0, 3.0)
            for event in step.begins:
                when.setdefault(event, begin)
            for event in step.happens:
                when[event] = max(clock[robot], when.get(event, 0.0))
            moved = True
        if not moved:
            return None
    return when


@pytest.mark.parametrize("seed", usually(0, of=(0, 2)))
def test_who_waits_for_an_end_waits_for_what_that_waits_for(tmp_path, seed):
    """Robots tell that they have done something whatever its end waits for."""
    problem, plan = floors.rounds(seed, floors.hall(tmp_path))
    rng = random.Random(f"ends {seed}")
    spans = {a["name"]: (a["start"], a["end"]) for a in plan["activities"]}
    whose = {t["activity"]: t["object"] for t in plan["motions"]}
    chains = [
        (one, two, three)
        for one, two, three in itertools.permutations(rng.sample(sorted(whose), len(whose)), 3)
        if len({whose[one], whose[two], whose[three]}) == 3
        if spans[two][0] <= spans[one][1] <= spans[two][1] <= spans[three][0]
    ]
    asked = rng.sample(chains, 3)
    for one, two, three in asked:
        first, then, last = map(problem.get_activity, (one, two, three))
        some = [GE(then.end, first.end), GE(last.start, then.end), GE(last.start, first.end)]
        for constraint in rng.sample(some, 3):
            problem.add_constraint(constraint)
    steps = steps_of(with_dependencies(problem, plan))
    for k in range(10):
        when = follow(steps, np.random.default_rng(k))
        assert when is not None
        for one, _, last in asked:
            assert when[Event(At.START, last)] > when[Event(At.END, one)] - 5e-3


def test_points_are_come_to_late_and_left_early(plan, tmp_path):
    """By the localisation error, whoever reads the nodes of the orders."""
    error = plan["dependencies"]["localisation"]
    assert error == 0.05
    motions = {(m["activity"], m["object"]): m for m in plan["motions"]}
    seen = set()
    for robot, own in steps_of(plan).items():
        for step in (s for s in own if s.piece is not None):
            motion = motions[step.activity, robot]
            times = [row[0] for row in motion["samples"]]
            low, high = np.interp(step.piece.rows[[0, -1], 0], times, motion["progress"])
            for event in (e for e in (*step.begins, *step.happens) if e.object):
                at = event.progress
                seen.add(event)
                if event.at is At.REACH:
                    assert high >= min(at + error, motion["progress"][-1]) - 2e-3
                else:
                    assert low <= max(at - error, 0.0) + 2e-3
    edges = plan["dependencies"]["edges"]
    ends = (event_from_list(edge[e]) for edge in edges for e in ("first", "then"))
    assert seen == {event for event in ends if event.object}
    export_plan(plan, "vda5050", tmp_path)
    told = read(tmp_path / "releases.json")
    assert told["localisation"] == error
    assert len(told["narrow"]) >= len(plan["dependencies"]["narrow"])


def test_releases_come_in_an_order_that_works(plan, tmp_path):
    """Whatever a message waits for is released by messages before it."""
    export_plan(plan, "vda5050", tmp_path)
    released: dict[tuple[str, str], int] = {}
    for entry, message in messages_of(tmp_path):
        for condition in entry["after"]:
            for sign in condition["seen"]:
                if "lastNodeSequenceId" in sign:
                    order = sign["serialNumber"], sign["orderId"]
                    assert released[order] >= sign["lastNodeSequenceId"]
        base = max(n["sequenceId"] for n in message["nodes"] if n["released"])
        released[entry["serialNumber"], message["orderId"]] = base


@FEWER
def test_legs_for_nav2_tell_paths_and_what_to_wait_for(plan, tmp_path):
    steps = steps_of(plan)
    files = [f for f in export_plan(plan, "nav2", tmp_path) if f.suffix == ".yaml"]
    assert {f.stem for f in files} == {r or "others" for r in steps}
    for file in files:
        data = yaml.safe_load(file.read_text())
        own = steps[data["robot"]]
        assert [leg["activity"] for leg in data["legs"]] == [s.activity for s in own]
        for leg, step in zip(data["legs"], own, strict=True):
            assert len(leg["wait_for"]) == len(step.waits)
            if step.piece is None:
                assert leg["do"] == step.activity
                continue
            poses, row = leg["path"]["poses"], step.piece.rows[-1]
            end = poses[-1]["pose"]
            assert end["position"]["x"] == pytest.approx(row[1], abs=1e-3)
            yaw = 2 * math.atan2(end["orientation"]["z"], end["orientation"]["w"])
            assert math.cos(yaw - row[3]) == pytest.approx(1.0, abs=1e-6)
            stamps = [p["header"]["stamp"] for p in poses]
            times = [s["sec"] + 1e-9 * s["nanosec"] for s in stamps]
            assert times == sorted(times)
            assert times[-1] == pytest.approx(row[0], abs=1e-6)


@FEWER
def test_paths_for_nav2_are_messages_of_their_type(plan, tmp_path):
    """Each path, as read from the file, is taken as a ``nav_msgs/Path`` and comes back whole."""
    ros = pytest.importorskip("mcap_ros2._dynamic")
    name, text = "nav_msgs/msg/Path", DEFINITIONS["nav_msgs/msg/Path"]
    encode = ros.serialize_dynamic(name, text)[name]
    decode = ros.generate_dynamic(name, text)[name]
    paths = [
        leg["path"]
        for file in export_plan(plan, "nav2", tmp_path)
        if file.suffix == ".yaml"
        for leg in yaml.safe_load(file.read_text())["legs"]
        if "path" in leg
    ]
    assert paths
    for path in paths:
        back = decode(encode(path))
        assert back.header.frame_id == "map"
        assert len(back.poses) == len(path["poses"])
        for got, told in zip(back.poses, path["poses"], strict=True):
            assert got.pose.position.y == told["pose"]["position"]["y"]
            assert got.pose.orientation.w == told["pose"]["orientation"]["w"]
            assert got.header.stamp.nanosec == told["header"]["stamp"]["nanosec"]


@pytest.mark.parametrize("form", ["vda5050", "nav2"])
def test_plans_without_dependencies_are_refused(tmp_path, form):
    with pytest.raises(ProblemError, match="no dependencies, without which such orders are unsafe"):
        export_plan(door_plan(), form, tmp_path)


def test_a_nurbs_of_degree_one_is_its_polyline():
    angles = np.linspace(0, math.pi, 50)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    curve = nurbs(points)
    count = len(curve["controlPoints"])
    assert len(curve["knotVector"]) == count + curve["degree"] + 1
    assert curve["knotVector"] == sorted(curve["knotVector"])
    assert curve["knotVector"][:2] == [0.0, 0.0]
    assert curve["knotVector"][-2:] == [1.0, 1.0]
    line = np.array([[c["x"], c["y"]] for c in curve["controlPoints"]])
    assert max(_gap(p, line) for p in points) <= 0.011


def test_every_robot_has_a_file_of_its_own():
    """Also where names differ in characters that files cannot have, or in case alone."""
    robots = ["others", "", "a b", "a_b", "A_b", "../a", "..", "a/b"]
    names = file_names(robots)
    assert len({n.lower() for n in names.values()}) == len(robots)
    assert not any("/" in n or n.startswith(".") for n in names.values())


def site(tmp_path):
    """Return a problem file whose words are not those of the package, and a plan of it."""
    fleet = Fleet("examples/maps/two_rooms.yaml", name="words")
    fleet.add_robot_type("agv", (0.8, 0.6), model="diff")
    for name, (x, y) in {"home": (3, 3), "rack": (10, 3), "dock": (10, 12)}.items():
        fleet.add_place(name, x, y)
    fleet.add_robot("r1", "agv", "home", end="home")
    fleet.add_order("o1", {"at": "rack", "action": "liftShelf"}, "dock")
    fleet.add_task("scan", "home", duration=3, action="readBarcodes", after="o1")
    file = fleet.save(tmp_path / "problem.yaml")
    fleet = Fleet.from_file(file)
    result = fleet.solve(first_plan=True)
    write_plan(tmp_path / "plan.json", with_dependencies(fleet.problem, result.data))
    return file


def test_orders_speak_the_words_of_the_site(tmp_path):
    file = site(tmp_path)
    export = ["export", str(tmp_path / "plan.json"), "--to", "vda5050", "--out", str(tmp_path)]
    assert main([*export, "--problem", str(file)]) == 0
    nodes = [n for _, m in messages_of(tmp_path) for n in m["nodes"]]
    edges = [e for _, m in messages_of(tmp_path) for e in m["edges"]]
    actions = {a["actionType"]: a for n in nodes for a in n["actions"]}
    assert actions.keys() == {"liftShelf", "drop", "readBarcodes"}
    told = {p["key"]: p["value"] for p in actions["liftShelf"]["actionParameters"]}
    assert told["for"] == "o1"
    assert actions["drop"]["actionId"] == "r1:deliver_o1_r1"
    at = {n["nodeId"]: n["nodePosition"] for n in nodes if "nodeDescription" in n}
    assert {name: (p["x"], p["y"]) for name, p in at.items()} == {
        "home": (3, 3), "rack": (10, 3), "dock": (10, 12)
    }  # fmt: skip
    assert {e[end] for e in edges for end in ("startNodeId", "endNodeId")} >= {"home", "rack"}
    for message in (m for _, m in messages_of(tmp_path)):
        ids = [n["nodeId"] for n in message["nodes"]]
        assert [e["startNodeId"] for e in message["edges"]] == ids[:-1]
        assert [e["endNodeId"] for e in message["edges"]] == ids[1:]
