"""A server on a free port of this machine, and a client that speaks HTTP to it."""

import json
import socket
import threading
import urllib.error
import urllib.request
from contextlib import contextmanager
from http.client import HTTPConnection

import uvicorn

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
        line = HTTPConnection("127.0.0.1", self.port, timeout=120)
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
    server = uvicorn.Server(uvicorn.Config(create_app(jobs, hosts), log_level="error"))
    door = socket.create_server(("127.0.0.1", 0))
    thread = threading.Thread(target=server.run, args=([door],), daemon=True)
    thread.start()
    try:
        yield Client(door.getsockname()[1])
    finally:
        server.should_exit = True
        thread.join(timeout=60)
        door.close()
