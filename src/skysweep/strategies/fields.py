"""Dotted fields of a scenario, with those that its strategy adds as ``search.parameters.NAME``."""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter
from typing import Any

from pydantic.fields import FieldInfo

from skysweep.scenarios.model import Scenario
from skysweep.strategies import strategy_spec

OWN = "search.parameters."


def own_fields(strategy: str) -> Iterator[tuple[str, FieldInfo]]:
    """Dotted names of what a strategy adds. Raises UserError where there is no such strategy."""
    for name, info in strategy_spec(strategy).parameters.model_fields.items():
        yield OWN + name, info


def checked(scenario: Scenario) -> Scenario:
    """The scenario. Raises UserError where its strategy is none, or has no such parameters."""
    strategy_spec(scenario.search.strategy).parameters_of(scenario.search)
    return scenario


def value_at(scenario: Scenario, field: str) -> Any:
    """The scenario's value of a dotted field; None where it is a parameter of another strategy."""
    if not field.startswith(OWN):
        return attrgetter(field)(scenario)
    own = strategy_spec(scenario.search.strategy).parameters_of(scenario.search)
    return getattr(own, field.removeprefix(OWN), None)
