"""What is told and heard by the words of each version of VDA 5050: orders are driven to their end,
and every message keeps the schemas of the standard, where these are here.
"""

import json
import math
import random
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("paho.mqtt", reason="needs the extra [mqtt]: paho-mqtt")

from tests.operate.days import Day
from tests.operate.sites import hall
from tests.operate.wire import AgvFloor
from up_samp.execution.reports import Go, Hold
from up_samp.operate.vda5050 import Agv, MasterControl

SCHEMAS = Path(__file__).parents[3] / "shared" / "data" / "vda5050"
FOLDERS = {"2.1.0": "2.1.0", "3.0.0": "main"}


def validators(version):
    """Return what says by topic what is wrong with a message of a version."""
    jsonschema = pytest.importorskip("jsonschema")
    folder = SCHEMAS / FOLDERS.get(version, "none")
    if not folder.is_dir():
        pytest.skip(f"needs the schemas of VDA 5050 {version} in {folder}")
    read = {f.stem: json.loads(f.read_text(encoding="utf-8")) for f in folder.glob("*.schema")}
    return {topic: jsonschema.Draft202012Validator(s).iter_errors for topic, s in read.items()}


def driven(tmp_path, version, watch=None):
    """Let a robot of a version do an order, be held and released; return the day."""
    quiet = {"lost": 0.0, "twice": 0.0, "late": 0.0}
    day = Day(tmp_path, robots=1, floor=partial(AgvFloor, version=version, **quiet))
    agv, wire = day.robots.agvs["r0"], day.robots.wire
    if watch is not None:
        plain = wire.publish

        def publish(topic, payload, qos=0):
            watch(topic.rpartition("/")[2], json.loads(payload))
            plain(topic, payload, qos)

        wire.publish = publish
    try:
        day.order("o0", "rack0", "dock2")
        day.until(lambda: agv.pose[0] > 4.0)
        if watch is not None:
            watch("state", agv.state())
        day.operation.hold("r0")
        day.until(lambda: agv.paused)
        day.operation.release("r0")
        day.run()
        assert day.verdict().good, day.story()
        assert agv.refused == []
        return day
    finally:
        day.operation.close()


@pytest.mark.parametrize("version", ["2.0.0", "3.0.0"])
@pytest.mark.long
def test_orders_are_driven_in_the_words_of_a_version(tmp_path, version):
    day = driven(tmp_path, version)
    assert [h.kind for h in day.robots.handled] == ["pick", "deliver"]
    order = day.robots.agvs["r0"].orders[0]
    assert order["version"] == version
    assert ("startNodeId" in order["edges"][0]) == (version == "2.0.0")


@pytest.mark.parametrize("version", ["2.1.0", "3.0.0"])
def test_messages_keep_the_schemas(tmp_path, version):
    wrong, seen = [], set()
    judges = validators(version)

    def watch(topic, message):
        seen.add(topic)
        wrong.extend(f"{topic}: {e.json_path} {e.message}" for e in judges[topic](message))

    driven(tmp_path, version, watch)
    assert seen == {"order", "instantActions", "state"}
    assert wrong == []


class Client:
    """A broker's client that is told what to say."""

    def __init__(self):
        self.sent = []

    def connect(self, *_args, **_options):
        self.on_connect(self)

    def loop_start(self):
        pass

    loop_stop = disconnect = subscribe = lambda *_args, **_options: None

    def publish(self, topic, payload, qos=0):
        self.sent.append((topic, json.loads(payload)))

    def say(self, topic, **message):
        path = f"uagv/v3/up_samp/r0/{topic}"
        self.on_message(self, None, SimpleNamespace(topic=path, payload=json.dumps(message)))


@pytest.fixture
def control(tmp_path):
    client = Client()
    return client, MasterControl(hall(tmp_path, 1).records, "h", client=client, version="3.0.0")


def test_what_is_seen_of_a_robot_counts_where_it_is_newer_than_its_state(control):
    client, master = control
    position = {"x": 1.0, "y": 2.0, "theta": 0.5, "mapId": "map", "localized": True}
    client.say("state", timestamp="2026-01-01T10:00:01.000Z", mobileRobotPosition=position)
    (first,) = master.reports(1.0)
    client.say(
        "visualization", timestamp="2026-01-01T10:00:01.500Z",
        mobileRobotPosition={**position, "x": 1.5},
    )  # fmt: skip
    (second,) = master.reports(1.5)
    client.say("visualization", timestamp="2026-01-01T10:00:00.500Z", mobileRobotPosition=position)
    client.say(
        "state", timestamp="2026-01-01T10:00:02.000Z", mobileRobotPosition={**position, "x": 2.0}
    )
    (third,) = master.reports(2.0)
    assert [r.pose for r in (first, second, third)] == [
        (1.0, 2.0, 0.5), (1.5, 2.0, 0.5), (2.0, 2.0, 0.5),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("first", "then", "newer"),
    [
        ("10:00:01Z", "10:00:01.5Z", True),  # a clock that leaves fractions out where they are 0
        ("10:00:01.5Z", "10:00:01.52Z", True),
        ("10:00:01.123456789Z", "10:00:01.1Z", False),
        ("10:00:01.000Z", "09:59:58.000Z", False),
        ("12:00:01+02:00", "10:00:02Z", True),
        ("10:00:01.000Z", "09:00:01.000Z", True),  # its clock was set, or it began anew
        ("23:59:59.000Z", "00:00:04.000Z", True),  # a day before: set, too
        ("10:00:01.000Z", "soon", True),
    ],
)
def test_states_count_in_the_order_of_sending_also_where_a_clock_is_set(
    control, first, then, newer
):
    client, master = control
    position = {"x": 1.0, "y": 2.0, "theta": 0.5, "localized": True}
    client.say("state", timestamp=f"2026-01-01T{first}", mobileRobotPosition=position)
    master.reports(1.0)
    later = {**position, "x": 1.5}
    client.say("state", timestamp=f"2026-01-01T{then}", mobileRobotPosition=later)
    assert [r.pose[0] for r in master.reports(2.0)] == [1.5] * newer


def test_what_was_seen_of_a_robot_by_another_clock_does_not_hide_where_it_is(control):
    client, master = control
    position = {"x": 1.0, "y": 2.0, "theta": 0.5, "localized": True}
    client.say("visualization", timestamp="2026-01-01T12:00:00Z", mobileRobotPosition=position)
    for k in range(3):
        there = {**position, "x": 2.0 + k}
        client.say("state", timestamp=f"2026-01-01T10:00:0{k}Z", mobileRobotPosition=there)
        (report,) = master.reports(float(k))
        assert report.pose[0] == 2.0 + k


@pytest.mark.parametrize(
    ("told", "level"), [(55.0, 0.55), (0, 0.0), (100.4, 1.0), (255, None), (-1, None), (None, None)]
)
def test_a_level_that_no_battery_has_is_a_fault(control, told, level):
    """Some tell 255 where they do not know it: that counted as full, and as more than that."""
    client, master = control
    client.say("state", timestamp="2026-01-01T10:00:00Z", powerSupply={"stateOfCharge": told})
    master.reports(0.0)
    assert master.levels.get("r0") == level
    wrong = level is None and told is not None
    assert master.faults == [("r0", f"its batteryCharge cannot be {told} percent")] * wrong


def test_where_a_robot_is_on_another_map_says_nothing_here(control):
    client, master = control
    position = {"x": 1.0, "y": 2.0, "theta": 0.5, "localized": True, "mapId": "ground"}
    for k, name in enumerate(("ground", "upstairs", "ground")):
        there = {**position, "mapId": name}
        client.say("state", timestamp=f"2026-01-01T10:00:0{k}Z", mobileRobotPosition=there)
        assert len(master.reports(float(k))) == (name == "ground")
    assert master.faults == [("r0", "it is on map 'upstairs', and was on 'ground'")]


def test_a_factsheet_that_promises_less_is_a_fault(control):
    client, master = control
    sheet = {"maximumSpeed": 1.0, "maximumAcceleration": 0.7, "length": 0.8, "width": 0.75}
    client.say("factsheet", physicalParameters=sheet)
    master.reports(0.0)
    assert master.faults == [
        ("r0", "its speedMax is 1, in the site file 1.5"),
        ("r0", "its width is 0.75 m, in the site file 0.6"),
    ]


def test_a_robot_that_comes_later_is_asked_what_it_is(control):
    client, master = control
    client.sent.clear()  # nobody was there to hear it
    client.say("connection", connectionState="ONLINE")
    master.reports(0.0)
    asked = [action["actionType"] for _, message in client.sent for action in message["actions"]]
    assert asked == ["factsheetRequest", "stateRequest"]


def test_a_robot_that_is_gone_is_told_nothing(control):
    client, master = control
    client.say("connection", connectionState="ONLINE")
    master.reports(0.0)
    assert master.agvs["r0"].online
    client.say("connection", connectionState="CONNECTION_BROKEN")
    master.reports(1.0)
    assert not master.agvs["r0"].online
    assert master.faults[0][1].startswith("its connection is broken")


STATE = {
    "timestamp": "2026-01-01T10:00:01.000Z", "orderId": "a", "orderUpdateId": 1, "paused": False,
    "lastNodeSequenceId": 2, "driving": True,
    "nodeStates": [
        {"sequenceId": 4, "released": True, "nodePosition": {"x": 2.0, "y": 2.0, "theta": 0.0}},
        {"sequenceId": 6, "released": False},
    ],
    "actionStates": [{"actionId": "b", "actionStatus": "FINISHED"}],
    "mobileRobotPosition": {"x": 1.5, "y": 2.0, "theta": 0.0, "localized": True},
    "powerSupply": {"stateOfCharge": 80.0, "charging": False},
}  # fmt: skip
ODD = (
    None, "x", [], {}, math.nan, math.inf, -1, 1e308, True, [1], [None], {"a": 1}, [[]], 10**400,
)  # fmt: skip


def oddly(rng, message):
    """A message in which something, however deep, is something else, or which is no message."""
    told, within = json.loads(json.dumps(message)), []
    places = [told]
    while places:
        one = places.pop()
        for key, value in one.items() if isinstance(one, dict) else enumerate(one):
            within.append((one, key))
            places += [value] if isinstance(value, dict | list) else []
    one, key = rng.choice(within)
    one[key] = rng.choice(ODD)
    text = json.dumps(told)
    return rng.choice((text, text, text, text[: rng.randrange(len(text))], "[" * 10**5, "[3]"))


@pytest.mark.parametrize("seed", range(2))
def test_what_a_robot_tells_oddly_is_its_fault_and_ends_nothing(tmp_path, seed):
    rng, client = random.Random(seed), Client()
    master = MasterControl(hall(tmp_path, 2).records, "h", client=client, version="3.0.0")
    ways = {("a", "r0"): SimpleNamespace(told=0.0)}
    executor = SimpleNamespace(state=SimpleNamespace(ways=ways), plan={"meanings": {"a": ()}})
    master._executor = executor
    sheet = {"physicalParameters": {"maximumSpeed": 1.0, "length": 0.8}}
    topics = [("state", STATE), ("visualization", STATE), ("factsheet", sheet)]
    topics.append(("connection", {"connectionState": "ONLINE"}))
    for k in range(400):
        agv = master.agvs["r0"] = Agv("r0", True, dict(STATE), order="a", activity="a", update=1)
        agv.known, agv.nodes = rng.random() < 0.5, [(0, 0.0), (4, 1.0)]
        master._motions = {"a": {"progress": [0.0, 1.0], "samples": [[0, 1, 2, 0], [1, 2, 2, 0]]}}
        topic, message = rng.choice(topics)
        path = f"uagv/v3/up_samp/r0/{topic}"
        told = oddly(rng, message).replace("10:00:01", "10:00:02")
        client.on_message(None, None, SimpleNamespace(topic=path, payload=told))
        errors = [r.error for r in master.reports(float(k)) if r.error is not None]
        assert not any(map(math.isnan, errors))
        master.tell({"r0": rng.choice((Go("a", 1.0), Go("a", 0.5), Hold(("x",))))}, float(k))
        master._begin(Agv("r0", True, agv.state), "a")  # as after a restart of this process
    assert any(words.startswith("its state cannot be read") for _, words in master.faults)
    client.on_message(
        None, None, SimpleNamespace(topic="uagv/v3/up_samp/r1/state", payload=json.dumps(STATE))
    )  # fmt: skip
    (heard,) = master.reports(999.0)
    assert (heard.robot, heard.pose) == ("r1", (1.5, 2.0, 0.0))
