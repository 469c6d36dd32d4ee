"""A model while it is built."""

from __future__ import annotations

from dataclasses import dataclass, field

from up_samp.scheduling.cpsat.encode.forms import Form
from up_samp.scheduling.cpsat.normal.form import NormalForm
from up_samp.scheduling.cpsat.problem import Additions


@dataclass
class ModelDraft:
    """What the families of a model hand on while it is built: the problem's parts in normal form,
    ``forms`` that are read from its constraints, and the ``rest`` that nothing else says.
    """

    form: NormalForm
    forms: list[Form] = field(default_factory=list)
    rest: list[Form] = field(default_factory=list)

    @property
    def parts(self) -> Additions:
        """All of the problem."""
        return self.form.parts
