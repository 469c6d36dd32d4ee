"""Put our engines, and those that UP does not know by itself, into a UP environment."""

from __future__ import annotations

import importlib
from typing import Any

import unified_planning.environment as up_environment
from unified_planning.environment import Environment

from up_samp.system.imports import load_cp_model

ENGINES = (
    ("cpsat", "up_samp.engines.cpsat", "CpsatEngine"),
    ("samp-validator", "up_samp.engines.validator", "SampValidator"),
)
META_ENGINES = (("samp-refine", "up_samp.engines.samp", "SampRefine"),)
_WITH_ORTOOLS = ("cpse",)
BEST = "samp-refine[cpsat]"
"""What UP takes for a problem with motions, if it is asked for no engine by name."""


def register(environment: Environment | None = None) -> None:
    """Register ``samp-refine``, ``cpsat``, ``samp-validator`` and known schedulers.

    ``environment`` is UP's global environment by default. Calling it twice does no harm. Engines
    whose packages are not installed are left out.
    """
    from up_samp.engines.factory import tell_by_name
    from up_samp.scheduling.quirks import known_engines

    env = environment or up_environment.get_environment()
    factory = env.factory
    tell_by_name(factory)
    for name, module, cls in (*ENGINES, *known_engines()):
        if name in factory.engines:
            continue
        try:
            if name in _WITH_ORTOOLS:
                load_cp_model()
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name is not None and error.name.startswith("up_samp"):
                raise
            continue
        factory.add_engine(name, module, cls)
    for name, module, cls in META_ENGINES:
        if not any(e.startswith(f"{name}[") for e in factory.engines):
            factory.add_meta_engine(name, module, cls)
    _prefer(factory, BEST)


def _prefer(factory: Any, best: str) -> None:
    """Let ``best`` come before our other meta-engines where UP chooses by a problem's kind; all
    others keep their places.
    """
    names = list(factory.preference_list)
    family = best.split("[")[0] + "["
    if best in names:
        first = next(i for i, name in enumerate(names) if name.startswith(family))
        names.insert(first, names.pop(names.index(best)))
        factory.preference_list = names


def register_globally() -> None:
    """Register in UP's global environment: now if it is there already, else when it is first used.

    UP makes it when it is first asked for, with all engines that it knows, which takes half a
    second; it has no hook for others.
    """
    if up_environment.GLOBAL_ENVIRONMENT is None:
        up_environment.GLOBAL_ENVIRONMENT = _Unmade()
    else:
        register(up_environment.GLOBAL_ENVIRONMENT)


class _Unmade(Environment):  # type: ignore[misc]
    """UP's global environment until something of it is used: then it is made, becomes a plain
    ``Environment`` and gets our engines.
    """

    def __init__(self) -> None:
        pass

    def _make(self) -> None:
        self.__class__ = Environment  # type: ignore[assignment]
        try:
            Environment.__init__(self)
            register(self)
        except BaseException:
            if up_environment.GLOBAL_ENVIRONMENT is self:
                up_environment.GLOBAL_ENVIRONMENT = None  # the next one who asks is told, too
            raise

    def __getattr__(self, name: str) -> Any:
        # only for what is not there yet: the fields that the properties of an environment read
        if name.startswith("__"):
            raise AttributeError(name)
        self._make()
        return getattr(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name != "__class__":
            self._make()
        object.__setattr__(self, name, value)

    def __reduce_ex__(self, protocol: Any) -> Any:  # for copies
        self._make()
        return self.__reduce_ex__(protocol)
