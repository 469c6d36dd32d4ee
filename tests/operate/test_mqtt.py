"""Orders over a real broker (Debian's mosquitto) to simulated AGVs of VDA 5050."""

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("paho.mqtt", reason="needs the extra [mqtt]: paho-mqtt")
BROKER = shutil.which("mosquitto") or shutil.which("/usr/sbin/mosquitto")
if BROKER is None:
    pytest.skip("needs the broker mosquitto", allow_module_level=True)

from tests.operate.sites import hall  # noqa: E402
from tests.operate.wire import OverBroker as Agv  # noqa: E402
from tests.operate.wire import unwound  # noqa: E402
from tests.server.soak_server import free_port  # noqa: E402
from up_samp.operate.clock import RealClock  # noqa: E402
from up_samp.operate.judge import contacts  # noqa: E402
from up_samp.operate.loop import Operation  # noqa: E402
from up_samp.operate.settings import Settings  # noqa: E402
from up_samp.operate.simulated import Drive  # noqa: E402
from up_samp.operate.store import Store  # noqa: E402
from up_samp.operate.vda5050 import MasterControl  # noqa: E402


def broker_at(port, folder):
    file = Path(folder) / "broker.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    process = subprocess.Popen([BROKER, "-c", str(file)], stderr=subprocess.DEVNULL)
    time.sleep(0.5)
    return process


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


NODE = shutil.which("node")
LIBRARY = os.environ.get("VDA_5050_LIB", "")
"""The folder node_modules that holds vda-5050-lib."""


@pytest.mark.skipif(
    NODE is None or not (Path(LIBRARY) / "vda-5050-lib").is_dir(),
    reason="needs node, and vda-5050-lib of npm in the folder that VDA_5050_LIB names",
)
def test_virtual_agvs_of_vda_5050_lib_do_their_orders(tmp_path, broker):
    fleet = hall(tmp_path, 4)
    script = Path(__file__).parent / "virtual_agv.js"
    agvs = []
    for k in range(4):
        pose = map(str, fleet.records.places[f"home{k}"].pose)
        agvs.append(
            subprocess.Popen(
                [NODE, str(script), str(broker), f"r{k}", *pose],
                env={**os.environ, "NODE_PATH": LIBRARY},
            )
        )
    traces = {f"r{k}": [] for k in range(4)}

    def watch(day):
        for name, agv in day.robots.agvs.items():
            at = agv.state.get("agvPosition")
            if at is not None:
                traces[name].append([time.time(), at["x"], at["y"], at["theta"]])

    orders = [
        {"id": f"o{k}", "pickup": f"rack{k % 3}", "delivery": f"dock{k % 3}"} for k in range(4)
    ]
    try:
        jobs = operated(
            tmp_path, broker, [], fleet, orders, 240, watch, version="2.0.0", spacing=0.25,
            types=dict.fromkeys(("pick", "deliver", "task", "open"), "noop"),
        )  # fmt: skip
    finally:
        for agv in agvs:
            agv.terminate()
            agv.wait()
    assert {j.state.value for j in jobs.values()} == {"done"}
    begin = min(rows[0][0] for rows in traces.values())
    drives = [
        Drive(name, "all", unwound([[t - begin, *p] for t, *p in rows]))
        for name, rows in traces.items()
    ]
    initial = {name: rows[0][1:] for name, rows in traces.items()}
    assert contacts(fleet.records, initial, drives) == []
