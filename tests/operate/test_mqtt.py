"""Orders over a real broker (Debian's mosquitto) to simulated AGVs of VDA 5050."""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import time
from datetime import datetime
from pathlib import Path

import pytest

pytest.importorskip("paho.mqtt", reason="needs the extra [mqtt]: paho-mqtt")
import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

BROKER = shutil.which("mosquitto") or shutil.which("/usr/sbin/mosquitto")
if BROKER is None:
    pytest.skip("needs the broker mosquitto", allow_module_level=True)

from tests.operate.sites import hall  # noqa: E402
from tests.operate.test_doors import two_rooms  # noqa: E402
from tests.operate.wire import OverBroker as Agv  # noqa: E402
from tests.operate.wire import unwound  # noqa: E402
from up_samp.execution.floor import Drive, Handled  # noqa: E402
from up_samp.model import ProblemError  # noqa: E402
from up_samp.operate.clock import RealClock  # noqa: E402
from up_samp.operate.judge import contacts, judge_day  # noqa: E402
from up_samp.operate.loop import Operation  # noqa: E402
from up_samp.operate.records import Settings  # noqa: E402
from up_samp.operate.store import Store  # noqa: E402
from up_samp.operate.vda5050 import MasterControl  # noqa: E402


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def begun(file, *ports):
    """Return a broker that answers already."""
    process = subprocess.Popen([BROKER, "-c", str(file)], stderr=subprocess.DEVNULL)
    for port in ports:
        for _ in range(600):
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                break
            assert process.poll() is None, "another process has its port"
            time.sleep(0.1)
    return process


def broker_at(port, folder):
    file = Path(folder) / "broker.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    return begun(file, port)


@pytest.fixture
def broker(tmp_path):
    port = free_port()
    process = broker_at(port, tmp_path)
    yield port
    process.terminate()
    process.wait()


def operated(folder, port, agvs, fleet, orders, seconds, during=lambda day: None, **options):
    """Operate until all orders are done; return the jobs."""
    control = MasterControl(fleet.records, "127.0.0.1", port, **options)
    day = Operation(
        fleet,
        store=Store(Path(folder) / "day.db", durable=False),
        robots=control,
        clock=RealClock(time.time()),
        settings=Settings(budget=20.0),
    )
    try:
        for order in orders:
            day.add(order)
        stop = time.monotonic() + seconds
        while not day.idle:
            notes = "\n".join(map(str, day.store.notes(most=30)))
            refused = [(a.name, why) for a in agvs for _, why in a.refused]
            assert time.monotonic() < stop, f"{notes}\n{refused}"
            day.step()
            during(day)
        return day.jobs
    finally:
        day.close()
        control.close()


def met(fleet, agvs):
    """Return who met, by where the AGVs really were."""
    initial = {a.name: a.trace[0][1:] for a in agvs}
    begin = min(a.trace[0][0] for a in agvs)
    drives = [Drive(a.name, "all", unwound([[t - begin, *p] for t, *p in a.trace])) for a in agvs]
    return contacts(fleet.records, initial, drives)


def test_agvs_do_their_orders_over_a_broker(tmp_path, broker):
    fleet = hall(tmp_path, 2, v_max=2.0, a_max=1.4, home=False)
    places = fleet.records.places
    faults = {"speed": 2.0, "noise": 0.01, "lost": 0.1, "twice": 0.1, "late": 0.1}
    agvs = [Agv(broker, f"r{k}", places[f"home{k}"].pose, **faults) for k in range(2)]
    # both come to dock1
    orders = [
        {"id": "o0", "pickup": "dock1", "delivery": "dock2"},
        {"id": "o1", "pickup": "dock0", "delivery": "dock1"},
    ]
    jobs = operated(tmp_path, broker, agvs, fleet, orders, 150)
    for agv in agvs:
        agv.close()
    assert {j.state.value for j in jobs.values()} == {"done"}
    assert [why for a in agvs for _, why in a.refused] == []
    assert met(fleet, agvs) == []


@pytest.mark.long
def test_a_broker_is_killed_and_started_again_twice(tmp_path):
    fleet, port = hall(tmp_path, 2, v_max=2.0, a_max=1.4, home=False), free_port()
    places, brokers, downs = fleet.records.places, [broker_at(port, tmp_path)], []
    faults = {"speed": 2.0, "noise": 0.01, "lost": 0.1, "twice": 0.1, "late": 0.1}
    agvs = [Agv(port, f"r{k}", places[f"home{k}"].pose, **faults) for k in range(2)]
    orders = [
        {"id": "o0", "pickup": "rack0", "delivery": "dock0"},
        {"id": "o1", "pickup": "rack2", "delivery": "dock1"},
    ]

    def trouble(day):
        ways = day.executor.state.of_object if day.executor else {}
        up, now = len(brokers) > len(downs), day.clock.now()
        if up and len(downs) < 2 and now > (downs or [0.0])[-1] + 8.0:
            if any(1.5 < way.progress < way.length - 2.0 for way in ways.values()):
                brokers[-1].kill()
                brokers[-1].wait()
                downs.append(now)
        elif not up and now > downs[-1] + 3.0:
            brokers.append(broker_at(port, tmp_path))

    try:
        jobs = operated(tmp_path, port, agvs, fleet, orders, 240, trouble)
    finally:
        for agv in agvs:
            agv.close()
        brokers[-1].kill()
        brokers[-1].wait()
    assert len(downs) == 2
    assert {j.state.value for j in jobs.values()} == {"done"}
    assert met(fleet, agvs) == []


class EnoughError(Exception):
    """What was to be seen has been seen."""


def test_who_comes_back_does_not_go_on_with_what_it_was_told_before(tmp_path, broker):
    fleet = hall(tmp_path, 2, home=False)
    places = fleet.records.places
    agvs = [Agv(broker, f"r{k}", places[f"home{k}"].pose) for k in range(2)]
    found = {}

    def moves():
        return [t for t in found["agv"].told if t in ("startPause", "stopPause", "cancelOrder")]

    def trouble(day):
        if not found:
            for name, way in day.executor.state.of_object.items() if day.executor else ():
                if way.progress > 2.0:
                    found["agv"] = agvs[int(name[1])]
                    day.leave(name)
        elif "joined" not in found and day.jobs["o0"].robot not in ("", found["agv"].name):
            # another one does its order now
            found["joined"] = tuple(found["agv"].pose)
            day.join(found["agv"].name)
            order = {"id": "o1", "pickup": "rack1", "delivery": "dock1"}
            day.add({**order, "robots": [found["agv"].name]})
        elif moves()[-1:] == ["stopPause"]:
            raise EnoughError
        elif "joined" in found:
            assert tuple(found["agv"].pose) == found["joined"]

    orders = [{"id": "o0", "pickup": "rack0", "delivery": "dock0"}]
    with pytest.raises(EnoughError):
        operated(tmp_path, broker, agvs, fleet, orders, 150, trouble)
    for agv in agvs:
        agv.close()
    assert moves() == ["startPause", "cancelOrder", "stopPause"]


OPENSSL, PASSWD = shutil.which("openssl"), shutil.which("mosquitto_passwd")


def certificates(folder):
    """Return a certificate of an authority of our own, and of a broker that it vouches for."""

    def call(*words):
        subprocess.run([OPENSSL, *words], cwd=folder, check=True, capture_output=True)

    new = ("req", "-newkey", "rsa:2048", "-nodes")
    call(*new, "-x509", "-keyout", "ca.key", "-out", "ca.crt", "-subj", "/CN=ours", "-days", "9")
    call(*new, "-keyout", "broker.key", "-out", "broker.csr", "-subj", "/CN=broker")
    (folder / "names").write_text("subjectAltName=DNS:localhost,IP:127.0.0.1\n")
    call(
        "x509", "-req", "-in", "broker.csr", "-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial",
        "-out", "broker.crt", "-days", "9", "-extfile", "names",
    )  # fmt: skip
    return folder / "ca.crt", folder / "broker.crt", folder / "broker.key"


@pytest.fixture
def guarded(tmp_path):
    """A broker with two doors: a plain one for the robots here, and one of TLS with a password."""
    if OPENSSL is None or PASSWD is None:
        pytest.skip("needs openssl, and mosquitto_passwd beside mosquitto")
    folder = tmp_path / "broker"
    folder.mkdir()
    authority, own, key = certificates(folder)
    words = folder / "passwords"
    subprocess.run([PASSWD, "-b", "-c", str(words), "planner", "secret"], check=True)
    plain, safe = free_port(), free_port()
    file = folder / "broker.conf"
    file.write_text(
        "per_listener_settings true\n"
        f"listener {plain} 127.0.0.1\nallow_anonymous true\n"
        f"listener {safe} 127.0.0.1\nallow_anonymous false\npassword_file {words}\n"
        f"certfile {own}\nkeyfile {key}\n"
    )
    for secret in (words, own, key):
        secret.chmod(0o644)  # the broker may run as somebody else
    for above in (folder, *folder.parents):
        if os.access(above, os.W_OK) and above != Path("/tmp"):
            above.chmod(above.stat().st_mode | 0o011)
    process = begun(file, plain, safe)
    yield plain, safe, str(authority)
    process.terminate()
    process.wait()


def heard(control, good, seconds=60):
    stop = time.monotonic() + seconds
    while not good():
        assert time.monotonic() < stop
        control.reports(0.0)
        time.sleep(0.05)


# paho leaves sockets open whose other end is refused
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_broker_is_spoken_to_over_tls_with_a_password(tmp_path, guarded):
    plain, safe, authority = guarded
    site = hall(tmp_path, 1).records
    planner = {"user": "planner", "password": "secret"}
    with pytest.raises(ProblemError, match=r"no broker at localhost:\d+: .*certificate verify"):
        MasterControl(site, "localhost", safe, tls=True, **planner)
    for wrong in ({}, {"user": "planner", "password": "guess"}):
        with pytest.raises(ProblemError, match="refuses: Not authorized"):
            MasterControl(site, "localhost", safe, tls=authority, **wrong)
    agv = Agv(plain, "r0", site.places["home0"].pose)
    control = MasterControl(site, "localhost", safe, tls=authority, **planner)
    try:
        heard(control, lambda: control.agvs["r0"].state)
        assert control.agvs["r0"].online
        until, asked = time.monotonic() + 60, {"factsheetRequest", "stateRequest"}
        while not asked <= {*agv.told} and time.monotonic() < until:
            time.sleep(0.05)
        assert asked <= {*agv.told}
    finally:
        control.close()
        agv.close()


def test_the_last_will_of_a_robot_is_heard(tmp_path, broker):
    site = hall(tmp_path, 1).records
    agv = Agv(broker, "r0", site.places["home0"].pose)
    control = MasterControl(site, "127.0.0.1", broker)
    try:
        heard(control, lambda: control.agvs["r0"].state)
        agv.stop = True
        agv.thread.join()
        agv.client.loop_stop()
        agv.client.socket().close()
        heard(control, lambda: not control.agvs["r0"].online)
        ((robot, why),) = control.faults
        assert robot == "r0"
        assert why.startswith("its connection is broken")
    finally:
        control.close()


NODE = shutil.which("node")
LIBRARY = os.environ.get("VDA_5050_LIB", "")
"""The folder node_modules that holds vda-5050-lib."""


@pytest.mark.skipif(
    NODE is None or not (Path(LIBRARY) / "vda-5050-lib").is_dir(),
    reason="needs node, and vda-5050-lib of npm in the folder that VDA_5050_LIB names",
)
def test_virtual_agvs_of_vda_5050_lib_drive_through_a_door_and_a_zone(tmp_path, broker):
    fleet = two_rooms(tmp_path, robots=4)
    fleet.add_zone("gateway", [(7.5, 3), (12.5, 3), (12.5, 6), (7.5, 6)], max_robots=1)
    script, names = Path(__file__).parent / "virtual_agv.js", [f"r{k}" for k in range(4)]
    agvs, told, begun = [], {name: [] for name in names}, time.time()
    for k, name in enumerate(names):
        pose = map(str, fleet.records.places[f"home{k}"].pose)
        with (tmp_path / name).open("w") as driven:
            agvs.append(
                subprocess.Popen(
                    [NODE, str(script), str(broker), name, *pose], stdout=driven,
                    env={**os.environ, "NODE_PATH": LIBRARY},
                )
            )  # fmt: skip

    def heard(_client, _data, message):
        state = json.loads(message.payload)
        at = datetime.fromisoformat(state["timestamp"].replace("Z", "+00:00")).timestamp()
        told[state["serialNumber"]].append({**state, "at": at - begun})

    listener = mqtt.Client(CallbackAPIVersion.VERSION2, "listener")
    listener.on_message = heard
    listener.connect("127.0.0.1", broker)
    listener.subscribe("uagv/v2/up_samp/+/state")
    listener.loop_start()
    orders = [
        {"id": f"o{k}", "pickup": f"rack{k % 2}", "delivery": "dock0", "robots": [f"r{k}"]}
        for k in range(4)
    ]
    try:
        jobs = operated(
            tmp_path, broker, [], fleet, orders, 400, version="2.0.0", spacing=0.25,
            types=dict.fromkeys(("pick", "deliver", "task", "open"), "noop"),
        )  # fmt: skip
    finally:
        listener.disconnect()
        listener.loop_stop()
        for agv in agvs:
            agv.terminate()
            agv.wait()
    drives, handled = [], done(told)
    for name in names:
        # the last line may be half written
        rows = [json.loads(line) for line in (tmp_path / name).read_text().splitlines()[:-1]]
        drives.append(Drive(name, "all", unwound([[t - begun, *pose] for t, *pose in rows])))
    initial = {d.robot: tuple(d.rows[0][1:]) for d in drives}
    verdict = judge_day(fleet.records, jobs, initial, drives, handled)
    assert verdict.good, (verdict, handled)
    kinds = [h.kind for h in handled]
    assert (len(kinds), kinds.count("open"), kinds.count("pick")) == (9, 1, 4)
    inside = [d for d in drives if max(row[1] for row in d.rows) > 12.5]
    assert len(inside) == 4


def done(told):
    """Return what robots did at places, by the states that they told."""
    handled = []
    for name, states in told.items():
        since, over = {}, {}
        for state in states:
            for action in state["actionStates"]:
                key = action["actionId"], action.get("actionDescription")
                since.setdefault(key, state["at"])
                if action["actionStatus"] == "FINISHED":
                    over.setdefault(key, state["at"])
        for (activity, what), until in over.items():
            kind, since_ = activity.partition("_")[0], since[activity, what]
            kind = kind if kind in ("open", "pick", "deliver") else "task"
            if what:  # told in an order, not at once
                handled.append(Handled(kind, what, name, since_, until))
    return handled
