"""How a strategy is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from numbers import Real
from typing import Any

from skysweep.errors import UserError
from skysweep.files.models import validated
from skysweep.scenarios.model import ALTITUDE_TOLERANCE_M, Model, Scenario, Search
from skysweep.strategies.context import MissionContext
from skysweep.strategies.failures import failure_words
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
    ``needs_sensor_model`` is not flown without one. ``cover_altitude_agl_m`` may be anybody's code:
    ``cover_altitude_of`` asks it.
    """

    make: MakeStrategy
    cover_altitude_agl_m: Callable[[Search], float] = scan_altitude_agl_m
    parameters: type[Model] = NoParameters
    needs_sensor_model: bool = False

    def cover_altitude_of(self, scenario: Scenario) -> float:
        """Height above ground, in metres, from which the area is covered.

        Raises UserError where the strategy's own function fails, or returns what is no height at which the
        scenario's ``safety`` lets a vehicle search.
        """
        where = f"search.strategy: {scenario.search.strategy}: cover_altitude_agl_m"
        try:
            returned: Any = self.cover_altitude_agl_m(scenario.search)
        except UserError:
            raise
        except (Exception, SystemExit) as error:
            raise UserError(
                f"{where} raises {failure_words(error)}; make it a function of the search (a staticmethod of "
                "a class) that returns metres above ground"
            ) from error
        safety = scenario.safety
        lowest_m = max(safety.descent_floor_agl_m, safety.altitude_min_agl_m)
        room_m = safety.altitude_max_agl_m + safety.fence_tolerance_m - ALTITUDE_TOLERANCE_M
        highest_m = min(safety.altitude_max_agl_m, room_m)
        if not isinstance(returned, Real):
            raise UserError(f"{where} returned {returned!r:.60}; return metres above ground")
        altitude_agl_m = float(returned)
        if not lowest_m <= altitude_agl_m <= highest_m:  # nor is NaN
            raise UserError(
                f"{where} returned {altitude_agl_m:g}; return {lowest_m:g} to {highest_m:g} m, or change "
                "safety.altitude_max_agl_m, descent_floor_agl_m or altitude_min_agl_m"
            )
        return altitude_agl_m

    def parameters_of(self, search: Search) -> Model:
        """What ``search.parameters`` says, with the defaults. Raises UserError on what is none of them."""
        source = f"search.parameters of {search.strategy}"
        if self.parameters.model_config.get("extra", "ignore") == "ignore":
            fields = self.parameters.model_fields
            known = [*fields, *(field.alias for field in fields.values() if field.alias)]
            for name in search.parameters:
                if name not in known:
                    instead = f"write one of {', '.join(known)}" if known else "leave it out"
                    raise UserError(f"{source}: {name}: there is no such field; {instead}")
        try:
            return validated(self.parameters, search.parameters, source)
        except UserError:
            raise
        except (Exception, SystemExit) as error:  # of a validator that is anybody's code
            raise UserError(f"{source}: their model raises {failure_words(error)}; mend it") from error

    def told_of(self, search: Search) -> dict[str, Any]:
        """``search.parameters`` without those that are the defaults: two searches that share it are the same.

        All of them where one sets another's default. Raises UserError as ``parameters_of``.
        """
        values, defaults = dict(self.parameters_of(search)), dict(self.parameters.model_construct())
        told = {
            name: value
            for name, value in search.parameters.items()
            if name not in values or name not in defaults or values[name] != defaults[name]
        }
        same = dict(self.parameters_of(search.model_copy(update={"parameters": told}))) == values
        return told if same else dict(search.parameters)
