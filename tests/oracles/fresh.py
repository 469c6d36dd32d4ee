"""Problems in an environment of their own."""

from contextlib import contextmanager

from unified_planning import environment


@contextmanager
def fresh_environment():
    """Let problems be made in an empty environment: the usual one keeps what all tests put there,
    functions among it that cannot be sent to other processes.
    """
    before, environment.GLOBAL_ENVIRONMENT = environment.GLOBAL_ENVIRONMENT, None
    try:
        yield
    finally:
        environment.GLOBAL_ENVIRONMENT = before
