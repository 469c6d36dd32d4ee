"""Start Python processes that import what this one would, and nothing else.

Python puts the current folder in front of ``sys.path`` for ``-c`` and ``-m``: a file named like
a module that lies there by chance, or by malice, would be run. Children get this process's path.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

_PATH = """
import sys
sys.path[:] = [p for p in sys.path if p] + [p for p in sys.argv.pop().split("\\n") if p]
"""

_BARE = """
import importlib, types
package = types.ModuleType("up_samp")
package.__path__ = [{folder!r}]
sys.modules["up_samp"] = package
importlib.import_module({module!r}).main()
"""


def command(code: str, arguments: Sequence[str] = ()) -> list[str]:
    """Return the command that runs Python ``code`` with ``sys.argv[1:] == arguments`` in a process
    of its own; start it with :func:`environment`.
    """
    # an engine may be a module in the folder that an interactive session was started in
    later = [os.path.abspath(p) for p in sys.path if not os.path.isabs(p)]
    return [sys.executable, *_flags(), "-c", _PATH + code, *arguments, "\n".join(later)]


def bare(module: str) -> str:
    """Return code that runs ``module.main()`` without what ``import up_samp`` registers: such a
    child starts sooner.
    """
    return _BARE.format(folder=str(Path(__file__).parents[1]), module=module)


def _flags() -> list[str]:
    # Python 3.10 has no -P, and imports nothing before the first line of -c
    return ["-P"] if sys.version_info >= (3, 11) else []


def environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return this process's environment variables with ``extra``, and its path for the child."""
    paths = [p for p in sys.path if os.path.isabs(p)]
    return {**os.environ, **(extra or {}), "PYTHONPATH": os.pathsep.join(paths)}


def die_with(descriptor: int) -> None:
    """End this process at once when ``descriptor`` (the read end of a pipe that only the parent
    holds open) is closed, however the parent goes away.
    """

    def watch() -> None:
        # not a buffered stream: its lock would be in the way when the interpreter ends
        while os.read(descriptor, 1):
            pass
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
