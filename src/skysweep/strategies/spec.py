"""How a strategy is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from skysweep.files.models import validated
from skysweep.scenarios.model import Model, Search
from skysweep.strategies.context import MissionContext
from skysweep.types import Strategy

MakeStrategy = Callable[[MissionContext], Strategy]


class NoParameters(Model):
    """Of a strategy that has none of its own."""


def scan_altitude_agl_m(search: Search) -> float:
    """h_S: from where most strategies cover the area."""
    return search.scan_altitude_agl_m


@dataclass(frozen=True, slots=True)
class StrategySpec:
    """How to make a strategy and which altitude its coverage is planned for.

    ``parameters`` says what ``search.parameters`` may hold: a model of fields with defaults. A strategy that
    ``needs_sensor_model`` is not flown without one.
    """

    make: MakeStrategy
    cover_altitude_agl_m: Callable[[Search], float] = scan_altitude_agl_m
    parameters: type[Model] = NoParameters
    needs_sensor_model: bool = False

    def parameters_of(self, search: Search) -> Model:
        """What ``search.parameters`` says, with the defaults. Raises UserError on what is none of them."""
        return validated(self.parameters, search.parameters, f"search.parameters of {search.strategy}")
