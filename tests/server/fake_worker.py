"""A job's process that does as its request tells, for tests of the server alone."""

import json
import os
import signal
import sys
import time

PLAN = {"makespan": 7, "seconds_per_unit": 1, "problem": "fake"}


def tell(**event):
    print(json.dumps(event), flush=True)


head = json.loads(sys.stdin.readline())
request = json.loads(sys.stdin.read())
for step in request.get("steps", ("progress", "plan", "0.05", "end")):
    if step == "plan":
        tell(event="plan", makespan=7, seconds_per_unit=1)
        tell(**PLAN)
    elif step == "progress":
        tell(event="progress", phase="schedule", message="looking", lower_bound=5, upper_bound=None)
    elif step == "end":
        end = {"status": "SOLVED_SATISFICING", "lower_bound": 5, "bound_kind": "relative"}
        tell(event="end", message="", **end)
    elif step == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif step == "flood":
        while True:
            tell(event="progress", phase="x" * 10_000, message="")
    elif step == "child":
        if os.fork() == 0:
            time.sleep(600)
        tell(event="progress", phase="child", message="")
    else:
        time.sleep(float(step))
