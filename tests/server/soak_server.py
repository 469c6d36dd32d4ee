"""A server in a process of its own, whose jobs are played: for tests that measure it."""

import socket
import sys
from pathlib import Path

import uvicorn

from up_samp.server.app import create_app
from up_samp.server.jobs import JobLimits, JobQueue

FAKE = (sys.executable, str(Path(__file__).with_name("fake_worker.py")))


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def main():
    limits = JobLimits(running=2, waiting=4, kept=20)
    with JobQueue(limits, FAKE) as jobs:
        uvicorn.run(create_app(jobs), port=int(sys.argv[1]), log_level="error")


if __name__ == "__main__":
    main()
