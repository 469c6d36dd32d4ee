"""Executors as nobody wishes for: the last task first, and workers that are lost."""

import pickle
from concurrent.futures import BrokenExecutor, Executor, Future


class Backwards(Executor):
    """Does its tasks in reverse order once an answer is asked for, with copies of what it is given;
    those whose numbers are in ``lost`` end with ``error``.
    """

    def __init__(self, lost=(), error=BrokenExecutor):
        self.lost, self.error, self.handed, self.waiting = set(lost), error, 0, []

    def submit(self, do, *given):
        future = Future()
        self.waiting.append((self.handed, future, do, pickle.loads(pickle.dumps(given))))
        self.handed += 1
        wait = future.result

        def result(timeout=None):
            while self.waiting:
                number, one, task, args = self.waiting.pop()
                if number in self.lost:
                    one.set_exception(self.error("the worker is gone"))
                else:
                    one.set_result(task(*args))
            return wait(timeout)

        future.result = result
        return future
