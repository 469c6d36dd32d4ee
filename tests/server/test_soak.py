"""Many clients, all kinds of requests: threads, folders, processes and memory stay as they were."""

import json
import os
import random
import socket
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

psutil = pytest.importorskip("psutil")
pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")
import yaml  # noqa: E402

from tests.server.client import Client, dumped  # noqa: E402
from tests.server.requests import starter_request  # noqa: E402

MEGABYTE = 2**20
NAMES = 200
"""Ids of jobs that clients remember."""


class Soak:
    """Clients that send what comes to their minds, and a note of what was answered."""

    def __init__(self, client, good):
        self.client, self.good = client, good
        self.names, self.answers = ["none"], Counter()
        self.text = {**good, "problem": yaml.safe_dump(good["problem"])}
        wrong = json.loads(json.dumps(good))
        wrong["problem"]["orders"][0]["pickup"] = "shelfX"
        self.bodies = [
            b"", b"[" * 50_000, b'{"timeout": NaN}', b'{"a":' * 900 + b"1" + b"}" * 900,
            b'{"timeout": ' + b"9" * 5001 + b"}", b"[" + b"[]," * 100_000 + b"[]]",
            dumped(wrong), dumped({**good, "engine": "gurobi"}),
            dumped({**good, "problem": "a: " + "[" * 5000}),
            dumped({**good, "map": {**good["map"], "image": "AAAA"}}),
        ]  # fmt: skip

    def post(self, rng):
        answer = self.client.post("/v1/plans", rng.choice((self.good, self.good, self.text)))
        if answer.status_code == 202:
            self.names = [*self.names[-NAMES:], answer.json()["id"]]
        return answer

    def wrong(self, rng):
        return self.client.send(rng.choice(("/v1/plans", "/v1/validate")), rng.choice(self.bodies))

    def stranger(self, rng):
        return self.client.get("/v1/plans", {"Host": "evil.example"})

    def list_all(self, rng):
        return self.client.get("/v1/plans")

    def look(self, rng):
        return self.client.get(f"/v1/plans/{rng.choice(self.names)}")

    def follow(self, rng):
        return self.client.get(f"/v1/plans/{rng.choice(self.names)}/events")

    def delete(self, rng):
        return self.client.delete(f"/v1/plans/{rng.choice(self.names[-8:])}")

    def post_and_delete(self, rng):
        answer = self.post(rng)
        if answer.status_code == 202:
            self.answers[
                "delete", self.client.delete(f"/v1/plans/{answer.json()['id']}").status_code
            ] += 1
        return answer

    def one(self, seed):
        rng = random.Random(seed)
        kinds = (self.post, self.post, self.post_and_delete, self.post_and_delete, self.wrong,
                 self.wrong, self.stranger, self.list_all, self.look, self.look, self.follow,
                 self.delete)  # fmt: skip
        kind = rng.choice(kinds)
        self.answers[kind.__name__, kind(rng).status_code] += 1

    def many(self, first, count):
        with ThreadPoolExecutor(8) as clients:
            list(clients.map(self.one, range(first, first + count)))


@pytest.fixture
def server(tmp_path):
    """A process that serves, its clients, and the folder of its temporary files."""
    door = socket.create_server(("127.0.0.1", 0))
    folder = tmp_path / "tmp"
    folder.mkdir()
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.server.soak_server", str(door.fileno())],
        cwd=root,
        env={**os.environ, "TMPDIR": str(folder)},
        pass_fds=[door.fileno()],
    )
    client = Client(door.getsockname()[1])
    door.close()  # the server's own stays open, and is asked from the beginning
    assert client.get("/v1/plans").status_code == 200
    yield psutil.Process(process.pid), client, folder
    process.terminate()
    process.wait(timeout=60)


def state(process, folder):
    """What a server holds: threads, processes below it, folders, megabytes (its own alone)."""
    return {
        "threads": process.num_threads(),
        "processes": len(process.children(recursive=True)),
        "folders": len(list(folder.iterdir())),
        "megabytes": process.memory_info().rss / MEGABYTE,
    }


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.long)])
def test_nothing_grows_with_the_number_of_requests(count, server, tmp_path):
    process, client, folder = server
    soak = Soak(client, starter_request(tmp_path / "mine"))
    soak.many(0, 100)
    before = state(process, folder)
    soak.many(100, count)
    while any(job["state"] in ("waiting", "running") for job in client.get("/v1/plans").json()):
        time.sleep(0.1)
    after = state(process, folder)
    print(count, before, after, sorted(soak.answers.items()))
    assert all(status < 500 or status == 503 for _, status in soak.answers)
    assert {200, 202, 404, 421, 422} <= {status for _, status in soak.answers}
    assert after["threads"] <= before["threads"] + 2  # of the pool for short calls
    assert after["processes"] <= 2 + 1  # two jobs that end, the desk
    assert after["folders"] <= 2 + 1
    assert after["megabytes"] < before["megabytes"] + 30
    assert len(client.get("/v1/plans").json()) <= 20


def test_bodies_of_many_small_things_cost_what_they_weigh(server):
    """Three of 3 MB cost 260 MB when they were kept as objects."""
    process, client, folder = server
    client.send("/v1/plans", b"[]")
    before = state(process, folder)
    body = b'{"problem": {"a": [' + b"[]," * ((3 * MEGABYTE - 60) // 3) + b'[]]}, "map": {}}'
    for _ in range(3):
        assert client.send("/v1/plans", body).status_code == 422
    after = state(process, folder)
    assert after["megabytes"] < before["megabytes"] + 60
