"""The service as its clients see it, with real problems."""

import base64
import io
import json
import re
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack

import pytest
import yaml
from PIL import Image

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")
from tests.server.client import serving
from tests.server.requests import starter_request
from up_samp.server.jobs import JobLimits, JobQueue


@pytest.fixture(scope="module")
def starter(tmp_path_factory):
    """A request: the starter problem with one order."""
    return starter_request(tmp_path_factory.mktemp("starter"))


LIMITS = JobLimits(request=200_000, look_seconds=120)
"""However busy the machine is, a request is looked at in time."""


@pytest.fixture(scope="module")
def client():
    with JobQueue(LIMITS) as jobs, serving(jobs, ["robots.example"]) as client:
        yield client


@pytest.fixture(scope="module")
def solved(client, starter):
    """The answer to the starter's request, when it has ended."""
    sent = client.post("/v1/plans", json=starter)
    assert sent.status_code == 202, sent.text
    return wait(client, sent.json()["id"])


def wait(client, name):
    until = time.monotonic() + 600
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


def faults(answer):
    assert answer.status_code == 422, answer.text
    return answer.json()["detail"]


def test_faults_of_a_problem_are_named_at_once(client, starter):
    wrong = json.loads(json.dumps(starter))
    wrong["problem"]["orders"][0]["pickup"] = "shelfX"
    (fault,) = faults(client.post("/v1/plans", json=wrong))
    assert fault["loc"] == ["body", "problem", "orders", 0, "pickup"]
    assert "orders[0].pickup: no place 'shelfX'" in fault["msg"]


def test_faults_of_a_problem_s_text_are_told_with_their_lines(client, starter):
    text = yaml.safe_dump(starter["problem"], sort_keys=False)
    pickup = starter["problem"]["orders"][0]["pickup"]
    line = next(i for i, said in enumerate(text.splitlines(), 1) if f"pickup: {pickup}" in said)
    text = text.replace(f"pickup: {pickup}", "pickup: shelfX", 1)
    (fault,) = faults(client.post("/v1/plans", json={**starter, "problem": text}))
    assert fault["msg"].startswith(f"problem.yaml:{line}: orders[0].pickup: no place 'shelfX'")
    (fault,) = faults(client.post("/v1/plans", json={**starter, "problem": "orders: [\n\n"}))
    assert fault["msg"].startswith("problem.yaml:3: not readable as YAML")


def test_yaml_and_pgm_are_taken(client, starter, solved):
    picture = Image.open(io.BytesIO(base64.b64decode(starter["map"]["image"]))).convert("L")
    picture.save(written := io.BytesIO(), format="PPM")
    pgm = {**starter["map"], "image": base64.b64encode(written.getvalue()).decode()}
    text = yaml.safe_dump(starter["problem"])
    sent = client.post("/v1/plans", json={**starter, "problem": text, "map": pgm})
    assert sent.status_code == 202, sent.text
    answer = wait(client, sent.json()["id"])
    assert answer["makespan"] == solved["makespan"], answer["message"]
    page = client.get(f"/v1/plans/{answer['id']}/animation.html").text
    assert "data:image/png;base64," in page
    assert "up-samp-" not in page


LONG = "9" * 5001
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize(
    ("change", "where", "said"),
    [
        ({"engine": "../../x"}, "engine", "there are: "),
        ({"engine": "gurobi"}, "engine", "there is no engine 'gurobi'; there are: "),
        ({"timeout": -1}, "timeout", "greater than 0"),
        ({"timeout": 10**400}, "timeout", ""),
        ({"seed": "a"}, "seed", "integer"),
        ({"problem": {"map": "/etc/passwd"}}, "problem", "must not name a map"),
        ({"problem": "map: /etc/passwd"}, "problem", "must not name a map"),
        ({"problem": []}, "problem", ""),
        ({"problem": ""}, "problem", "a problem file has keys"),
        ({"problem": "a: " + "[" * 40_000}, "problem", "problem.yaml:1: nested too deeply"),
        ({"problem": f"margin: {LONG}"}, "problem", "problem.yaml"),
        ({"map": {"image": "AAAA", "resolution": 0.1}}, "map", "neither PNG nor PGM"),
        ({"map": {"image": "\u00e9", "resolution": 0.1}}, "map", "no base64"),
        (
            {"map": {"image": base64.b64encode(PNG).decode(), "resolution": 0.1}},
            "map",
            "its image 'map.png' cannot be read",
        ),
        ({"map": {"image": "UDUKLTMgNQoyNTUK", "resolution": 0.1}}, "map", "map.pgm"),
        ({"more": 1}, "more", "not permitted"),
        ({"m" * 10_000: 1}, "m" * 97 + "...", "not permitted"),
    ],
)
def test_requests_are_looked_at_before_anything_starts(client, starter, change, where, said):
    known = len(client.get("/v1/plans").json())
    found = faults(client.post("/v1/plans", json={**starter, **change}))
    assert where in [part for fault in found for part in fault["loc"]]
    assert said in "; ".join(fault["msg"] for fault in found)
    assert "/tmp" not in json.dumps(found)
    assert len(json.dumps(found)) < 3000
    assert len(client.get("/v1/plans").json()) == known


@pytest.mark.parametrize(
    "body",
    [
        b"", b"{", b"\xff", b"[]", b"null", b"[" * 100_000, b'{"a":' * 900 + b"1" + b"}" * 900,
        b'{"timeout": NaN}', b'{"timeout": Infinity}', b'{"timeout": -Infinity}',
        b'{"timeout": 1e999}', f'{{"timeout": {LONG}}}'.encode(), b"[" + b"[]," * 60_000 + b"[]]",
    ],
    ids=lambda body: body[:20].decode(errors="replace"),
)  # fmt: skip
@pytest.mark.parametrize("path", ["/v1/plans", "/v1/validate"])
def test_bodies_that_are_no_requests_are_refused(client, body, path):
    assert faults(client.send(path, body))


def test_numbers_that_are_none_are_refused_wherever_they_are(client, starter):
    text = json.dumps(starter)
    resolution = f'"resolution": {starter["map"]["resolution"]}'
    assert resolution in text
    for odd in ("NaN", "Infinity", "1e999", LONG, "[" * 900 + "]" * 900):
        body = text.replace(resolution, f'"resolution": {odd}').encode()
        assert faults(client.send("/v1/plans", body))
        problem = {**starter["problem"], "seconds_per_unit": "HERE"}
        body = json.dumps({**starter, "problem": problem}).replace('"HERE"', odd).encode()
        assert faults(client.send("/v1/plans", body))


def test_no_file_of_the_server_can_be_named(client, starter):
    wrong = json.loads(json.dumps(starter))
    wrong["problem"]["robot_types"]["agv"]["footprint"] = "/etc/passwd"
    (fault, *_) = faults(client.post("/v1/plans", json=wrong))
    assert "footprint" in fault["loc"]
    assert "root:" not in fault["msg"]


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "localhost"}, 200),
        ({"Host": "LOCALHOST:80"}, 200),
        ({"Host": "[::1]:8008"}, 200),
        ({"Host": "robots.example:8008"}, 200),
        ({"Host": "evil.example"}, 421),
        ({"Host": "127.0.0.1.evil.example"}, 421),
        ({"Host": "localhost@evil.example"}, 421),
        ({"Host": ""}, 421),
        ({"Host": "[::1"}, 421),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": "http://localhost:8008"}, 200),
    ],
)
def test_only_own_names_are_answered(client, headers, status):
    """Else any page could have its own name lead here, and read plans."""
    assert client.get("/v1/plans", headers).status_code == status


def test_forms_of_other_pages_are_turned_away(client):
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data"):
        assert client.send("/v1/plans", b"{}", **{"Content-Type": kind}).status_code == 415


def test_jobs_are_listed(client, solved):
    rows = {row["id"]: row for row in client.get("/v1/plans").json()}
    assert rows[solved["id"]]["makespan"] == solved["makespan"]
    assert "plan" not in rows[solved["id"]]


def test_a_client_that_comes_back_with_nonsense_begins_anew(client, solved):
    for odd in ("x", "-1", LONG, "1e3"):
        path = f"/v1/plans/{solved['id']}/events"
        assert "id: 0\n" in client.get(path, headers={"Last-Event-ID": odd}).text


def test_a_body_that_does_not_arrive_is_not_waited_for():
    with JobQueue(JobLimits(body_seconds=1)) as jobs, serving(jobs) as client:
        head = {"Content_Length": "100", "Content_Type": "application/json"}
        assert client.announce("/v1/plans", **head) == 408


def test_three_hundred_slow_clients_cost_the_others_nothing(starter):
    """Half of them stop within the head of a request, half within its body."""
    head = "POST /v1/plans HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
    with (
        JobQueue(JobLimits(body_seconds=2, look_seconds=120)) as jobs,
        serving(jobs) as client,
        ExitStack() as lines,
    ):
        slow = [
            lines.enter_context(socket.create_connection(("127.0.0.1", client.port), timeout=60))
            for _ in range(300)
        ]
        for line in slow[::2]:
            line.sendall(head.encode())
        for line in slow[1::2]:
            line.sendall(f"{head}Content-Length: 100\r\n\r\n{{".encode())
        threads = threading.active_count()
        assert client.get("/v1/plans").status_code == 200
        assert client.post("/v1/plans", json=starter).status_code == 202
        assert all(b" 408 " in line.recv(4096) for line in slow[1::2])
        assert client.post("/v1/plans", json=starter).status_code in (202, 503)
        assert threading.active_count() < threads + 50  # a pool's, not one for each


def test_what_arrives_at_once_is_bounded():
    with JobQueue(JobLimits(arriving=1000)) as jobs, serving(jobs) as client:
        answer = client.send("/v1/plans", b" " * 2000)
        assert answer.status_code == 503


def _address_space(code):
    """Return the most address space, in bytes, that a process needs to run ``code``."""
    status = "print(open('/proc/self/status').read())"
    told = subprocess.run(
        [sys.executable, "-c", f"{code}; {status}"], capture_output=True, text=True, check=True
    )
    return 1024 * int(re.search(r"VmPeak:\s*(\d+)", told.stdout)[1])


@pytest.mark.skipif(sys.platform != "linux", reason="address space is limited on Linux only")
def test_what_takes_too_much_to_look_at_is_refused_and_the_next_is_not(starter):
    needed = _address_space("import up_samp.server.requests, up_samp.geometry.maps")
    limits = JobLimits(look_memory=needed + 96 * 2**20, look_seconds=120)
    with JobQueue(limits) as jobs, serving(jobs) as client:
        answer = client.send("/v1/plans", b"[" + b"[]," * 2_000_000 + b"[]]")
        assert answer.status_code == 422
        assert "too much memory" in answer.json()["detail"]
        answer = client.post("/v1/plans", json=starter)
        assert answer.status_code == 202, answer.json()


def test_large_requests_are_turned_away_unread(client):
    assert client.announce("/v1/plans", Content_Length="300000") == 413
    assert client.announce("/v1/plans", Transfer_Encoding="chunked") == 411
    assert client.announce("/v1/plans", Content_Length="9" * 14) == 413


def test_what_is_not_there_is_said_to_be_not_there(client):
    for method, path in (("get", ""), ("get", "/events"), ("delete", "")):
        answer = getattr(client, method)(f"/v1/plans/none{path}")
        assert answer.status_code == 404
        assert "'none'" in answer.json()["detail"]


def test_a_job_can_be_stopped_and_its_best_plan_kept(client, starter):
    longer = {**starter, "first_plan": False, "timeout": 60}
    name = client.post("/v1/plans", json=longer).json()["id"]
    for _ in range(2400):
        if client.get(f"/v1/plans/{name}").json()["plan"] is not None:
            break
        time.sleep(0.1)
    stopped = client.delete(f"/v1/plans/{name}").json()
    assert stopped["plan"] is not None
    assert stopped["state"] in ("stopped", "done")


def test_the_interface_describes_itself(client):
    document = client.get("/openapi.json").json()
    paths = document["paths"]
    assert document["info"]["x-limits"]["request"] == 200_000
    post = paths["/v1/plans"]["post"]
    assert {"202", "403", "408", "411", "413", "415", "421", "422", "503"} <= set(post["responses"])
    asked = post["requestBody"]["content"]["application/json"]["schema"]["$ref"]
    assert {"problem", "map", "engine"} <= set(at(document, asked)["properties"])
    for reference in re.findall(r'"\$ref": "([^"]+)"', json.dumps(document)):
        assert at(document, reference)
    assert {"/v1/plans", "/v1/plans/{name}", "/v1/plans/{name}/events", "/v1/validate"} <= set(
        paths
    )
    assert "<title>up_samp</title>" in client.get("/").text


def at(document, reference):
    for key in reference.removeprefix("#/").split("/"):
        document = document[key]
    return document
