"""A server on a free port of this machine, and a client that speaks HTTP to it."""

import json
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager
from http.client import HTTPConnection

import uvicorn

from tests.server.soak_server import free_port
from up_samp.server.app import create_app


class Answer:
    def __init__(self, status_code, data):
        self.status_code = status_code
        self.text = data.decode()

    def json(self):
        return json.loads(self.text)


class Client:
    def __init__(self, port):
        self.port = port
        self.url = f"http://127.0.0.1:{port}"

    def _ask(self, method, path, data=None, headers=None):
        asked = urllib.request.Request(self.url + path, data, dict(headers or {}), method=method)
        try:
            with urllib.request.urlopen(asked, timeout=120) as answer:
                return Answer(answer.status, answer.read())
        except urllib.error.HTTPError as error:
            with error:
                return Answer(error.code, error.read())

    def get(self, path, headers=None):
        return self._ask("GET", path, headers=headers)

    def delete(self, path):
        return self._ask("DELETE", path)

    def post(self, path, json=None):
        return self.send(path, dumped(json))

    def send(self, path, body, **headers):
        headers = {"Content-Type": "application/json", **headers}
        return self._ask("POST", path, body, headers)

    def announce(self, path, **headers):
        """Send the head of a POST and no body; return the status."""
        line = HTTPConnection("127.0.0.1", self.port, timeout=30)
        line.putrequest("POST", path)
        for name, value in headers.items():
            line.putheader(name.replace("_", "-"), value)
        line.endheaders()
        status = line.getresponse().status
        line.close()
        return status


def dumped(value):
    return json.dumps(value).encode()


@contextmanager
def serving(jobs, hosts=()):
    """Serve jobs for as long as the context lasts."""
    port = free_port()
    server = uvicorn.Server(
        uvicorn.Config(create_app(jobs, hosts), host="127.0.0.1", port=port, log_level="error")
    )
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.02)
    try:
        yield Client(port)
    finally:
        server.should_exit = True
        thread.join(timeout=20)
