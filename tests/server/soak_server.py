"""A server in a process of its own, at a socket that it is given, whose jobs are played: for tests
that measure it.
"""

import socket
import sys
from pathlib import Path

import uvicorn

from up_samp.server.app import create_app
from up_samp.server.jobs import JobLimits, JobQueue

FAKE = (sys.executable, str(Path(__file__).with_name("fake_worker.py")))


def main():
    limits = JobLimits(running=2, waiting=4, kept=20)
    door = socket.socket(fileno=int(sys.argv[1]))
    with JobQueue(limits, FAKE) as jobs:
        uvicorn.Server(uvicorn.Config(create_app(jobs), log_level="error")).run([door])


if __name__ == "__main__":
    main()
