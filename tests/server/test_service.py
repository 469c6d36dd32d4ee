"""The service as its clients see it, with real problems."""

import base64
import json
import time

import pytest
import yaml

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")
from tests.server.client import serving
from up_samp.fleet.starter import write_starter
from up_samp.server.jobs import JobQueue, Limits


@pytest.fixture(scope="module")
def starter(tmp_path_factory):
    """A request: the starter problem with one order."""
    folder = tmp_path_factory.mktemp("starter")
    problem_file, map_file, image = write_starter(folder)
    problem = yaml.safe_load(problem_file.read_text())
    del problem["map"]
    problem["orders"] = problem["orders"][:1]
    said = yaml.safe_load(map_file.read_text())
    upload = {
        "image": base64.b64encode(image.read_bytes()).decode(),
        "resolution": said["resolution"],
        "origin": said["origin"],
    }
    return {"problem": problem, "map": upload, "timeout": 60, "first_plan": True}


@pytest.fixture(scope="module")
def client():
    with JobQueue(Limits(request=200_000)) as jobs, serving(jobs) as client:
        yield client


@pytest.fixture(scope="module")
def solved(client, starter):
    """The answer to the starter's request, when it has ended."""
    sent = client.post("/v1/plans", json=starter)
    assert sent.status_code == 202, sent.text
    return wait(client, sent.json()["id"])


def wait(client, name):
    until = time.monotonic() + 120
    while time.monotonic() < until:
        answer = client.get(f"/v1/plans/{name}").json()
        if answer["state"] not in ("waiting", "running"):
            return answer
        time.sleep(0.1)
    raise AssertionError(answer)


def test_a_problem_is_planned(solved):
    assert solved["state"] == "done", solved["message"]
    assert solved["status"].startswith("SOLVED"), solved["message"]
    assert solved["plan"]["makespan"] == solved["makespan"]
    assert solved["lower_bound"] <= solved["makespan"]
    assert solved["plan"]["map"] == {"yaml": None}
    assert solved["plan"]["dependencies"]["edges"]


def test_events_come_as_server_sent_events(client, solved):
    text = client.get(f"/v1/plans/{solved['id']}/events").text
    events = [block.split("\n") for block in text.strip().split("\n\n")]
    kinds = [line[7:] for block in events for line in block if line.startswith("event: ")]
    assert kinds[0] == "progress"
    assert "plan" in kinds
    assert kinds[-1] == "state"
    state = json.loads(events[-1][-1].removeprefix("data: "))
    assert state["makespan"] == solved["makespan"]
    ids = [int(line[4:]) for block in events for line in block if line.startswith("id: ")]
    later = client.get(
        f"/v1/plans/{solved['id']}/events", headers={"Last-Event-ID": str(ids[-2])}
    ).text
    assert f"id: {ids[-1]}" in later
    assert f"id: {ids[-2]}\n" not in later


def test_the_plan_can_be_played(client, solved):
    page = client.get(f"/v1/plans/{solved['id']}/animation.html")
    assert page.status_code == 200
    assert "data:image/png;base64," in page.text


def test_a_plan_is_judged(client, starter, solved):
    asked = {"problem": starter["problem"], "map": starter["map"], "plan": solved["plan"]}
    good = client.post("/v1/validate", json=asked)
    assert good.status_code == 200, good.text
    assert good.json() == {"valid": True, "violations": []}
    moved = json.loads(json.dumps(solved["plan"]))
    for row in moved["motions"][0]["samples"][1:-1]:
        row[1] += 2.0
    bad = client.post("/v1/validate", json={**asked, "plan": moved}).json()
    assert bad["valid"] is False
    assert bad["violations"]


def test_faults_of_a_problem_are_named(client, starter):
    wrong = json.loads(json.dumps(starter))
    wrong["problem"]["orders"][0]["pickup"] = "shelfX"
    name = client.post("/v1/plans", json=wrong).json()["id"]
    answer = wait(client, name)
    assert answer["state"] == "failed"
    assert "orders[0].pickup: no place 'shelfX'" in answer["message"]


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"engine": "../../x"}, "engine"),
        ({"timeout": -1}, "timeout"),
        ({"seed": "a"}, "seed"),
        ({"problem": {"map": "/etc/passwd"}}, "problem"),
        ({"problem": []}, "problem"),
        ({"map": {"image": "AAAA", "resolution": 0.1}}, "map"),
        ({"more": 1}, "more"),
    ],
)
def test_requests_are_checked_before_anything_starts(client, starter, change, where):
    answer = client.post("/v1/plans", json={**starter, **change})
    assert answer.status_code == 422
    assert where in [part for fault in answer.json()["detail"] for part in fault["loc"]]


def test_no_file_of_the_server_can_be_named(client, starter):
    wrong = json.loads(json.dumps(starter))
    wrong["problem"]["robot_types"]["agv"]["footprint"] = "/etc/passwd"
    answer = wait(client, client.post("/v1/plans", json=wrong).json()["id"])
    assert answer["state"] == "failed"
    assert "root:" not in answer["message"]


def test_large_requests_are_turned_away_unread(client):
    assert client.announce("/v1/plans", Content_Length="300000") == 413
    assert client.announce("/v1/plans", Transfer_Encoding="chunked") == 411


def test_what_is_not_there_is_said_to_be_not_there(client):
    for method, path in (("get", ""), ("get", "/events"), ("delete", "")):
        answer = getattr(client, method)(f"/v1/plans/none{path}")
        assert answer.status_code == 404
        assert "'none'" in answer.json()["detail"]


def test_a_job_can_be_stopped_and_its_best_plan_kept(client, starter):
    longer = {**starter, "first_plan": False, "timeout": 60}
    name = client.post("/v1/plans", json=longer).json()["id"]
    for _ in range(600):
        if client.get(f"/v1/plans/{name}").json()["plan"] is not None:
            break
        time.sleep(0.1)
    stopped = client.delete(f"/v1/plans/{name}").json()
    assert stopped["plan"] is not None
    assert stopped["state"] in ("stopped", "done")


def test_the_interface_describes_itself(client):
    paths = client.get("/openapi.json").json()["paths"]
    assert {"/v1/plans", "/v1/plans/{name}", "/v1/plans/{name}/events", "/v1/validate"} <= set(
        paths
    )
    assert "<title>up_samp</title>" in client.get("/").text
