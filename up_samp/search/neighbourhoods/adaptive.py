"""Which neighbourhood is tried next, and how many robots it frees: by what it brought so far."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass, field

from up_samp.search.neighbourhoods.choices import Choice
from up_samp.search.tuning import NeighbourhoodsTuning


@dataclass
class Roulette:
    """Draws neighbourhoods by their weights (Ropke and Pisinger 2006), which follow their gains.

    ``size``: how many robots are freed next. It grows where nothing better was left to be found
    among so few, and shrinks where there was no end to the search.
    """

    choices: Sequence[Choice]
    tuning: NeighbourhoodsTuning
    chance: random.Random
    most: int
    weights: list[float] = field(default_factory=list)
    size: float = 0.0

    def __post_init__(self) -> None:
        self.weights = [1.0] * len(self.choices)
        self.size = float(min(self.tuning.robots, self.most))

    def draw(self) -> int:
        """Return the number of the next neighbourhood."""
        return self.chance.choices(range(len(self.choices)), self.weights)[0]

    def learn(self, drawn: int, gain: float) -> None:
        """Note what a neighbourhood brought: 1 for a better plan, less for less."""
        keep = 1.0 - self.tuning.reaction
        weight = keep * self.weights[drawn] + self.tuning.reaction * gain
        self.weights[drawn] = max(self.tuning.least_weight, weight)

    def searched(self, *, wholly: bool) -> None:
        """Note that a neighbourhood brought nothing, and whether it was searched wholly."""
        step = self.tuning.growth if wholly else -2 * self.tuning.growth
        self.size = min(float(self.most), max(1.0, self.size + step))

    @property
    def robots(self) -> int:
        """How many robots to free now."""
        return round(self.size)
