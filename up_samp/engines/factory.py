"""UP's factory, asked for engines by name."""

from __future__ import annotations

from typing import Any

import unified_planning.environment as up_environment
from unified_planning.engines import Engine, Factory
from unified_planning.exceptions import UPNoRequestedEngineAvailableException

from up_samp.model import ProblemError
from up_samp.scheduling.quirks import no_engine


def tell_by_name(factory: Factory) -> None:
    """Let UP's own factory name the engines there are."""
    if type(factory) is Factory:
        factory.__class__ = _Factory


def engine_named(name: str) -> type[Engine]:
    """Return the engine ``name`` of UP's factory.

    Raises :class:`ProblemError` that names the engines there are.
    """
    factory = up_environment.get_environment().factory
    if name not in factory.engines:
        raise ProblemError(no_engine(name, factory.engines))
    return factory.engine(name)


class _Factory(Factory):  # type: ignore[misc]
    """UP's factory, which names the engines there are where one is not."""

    def _get_engine_class(
        self, operation_mode: Any, name: str | None = None, *args: Any, **kwargs: Any
    ) -> Any:
        if name is not None and name not in self._engines:
            raise UPNoRequestedEngineAvailableException(no_engine(name, self.engines))
        return super()._get_engine_class(operation_mode, name, *args, **kwargs)
