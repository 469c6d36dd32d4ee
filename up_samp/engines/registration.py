"""Put our engines, and those that UP does not know by itself, into a UP environment."""

from __future__ import annotations

import importlib

import unified_planning as up
from unified_planning.environment import Environment

from up_samp.scheduling import known_engines

ENGINES = (
    ("cpsat", "up_samp.engines.cpsat", "CpsatEngine"),
    ("samp-validator", "up_samp.engines.validator", "SampValidator"),
)
META_ENGINES = (("samp-refine", "up_samp.engines.samp", "SampRefine"),)


def register(environment: Environment | None = None) -> None:
    """Register ``samp-refine``, ``cpsat``, ``samp-validator`` and known schedulers.

    ``environment`` is UP's global environment by default. Calling it twice does no harm. Engines
    whose packages are not installed are left out.
    """
    env = environment or up.environment.get_environment()
    factory = env.factory
    for name, module, cls in (*ENGINES, *known_engines()):
        if name in factory.engines:
            continue
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name is not None and error.name.startswith("up_samp"):
                raise
            continue
        factory.add_engine(name, module, cls)
    for name, module, cls in META_ENGINES:
        if not any(e.startswith(f"{name}[") for e in factory.engines):
            factory.add_meta_engine(name, module, cls)
