"""Turns the user's own parts of a mission into what a rig takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias, TypeVar

from skysweep.api.worlds import World
from skysweep.errors import UserError
from skysweep.scenarios.model import Scenario
from skysweep.strategies import strategy_spec
from skysweep.strategies.given import name_of, spec_of
from skysweep.strategies.spec import MakeStrategy, StrategySpec
from skysweep.types import Camera, Detector, Truth, Vehicle
from skysweep.worlds import world as worlds

StrategyLike: TypeAlias = str | MakeStrategy  # a name, a class, or a function that makes one
DetectorLike: TypeAlias = str | Detector | Callable[[Scenario], Detector]
CameraLike: TypeAlias = Camera | Callable[[Scenario, World, Truth], Camera]
VehicleLike: TypeAlias = Vehicle | Callable[[Scenario, int], Vehicle]

_Part = TypeVar("_Part")

_METHODS = {
    "detector": ("detect", "class_names"),
    "camera": ("capture", "close", "renderer"),
    "vehicle": ("state", "command", "advance", "takeoff", "land", "hold", "truth"),
}


def strategy_of(given: StrategyLike) -> tuple[str, StrategySpec]:
    """A strategy's name in a scenario, and how it is made. Raises UserError."""
    if isinstance(given, str):
        return given, strategy_spec(given)
    return name_of(given), spec_of(given)


def detector_of(given: Detector | Callable[[Scenario], Detector], scenario: Scenario) -> Detector:
    """The given detector, or the one that is made. Raises UserError where it knows no searched class."""
    detector = part_of("detector", given, scenario)
    known, searched = tuple(detector.class_names), scenario.target_classes
    if searched and not set(known).intersection(searched):
        raise UserError(
            f"detector: {type(detector).__name__} knows the classes {', '.join(known) or 'none'}, and the "
            f"mission searches for {', '.join(searched)}; write one of these in its class_names"
        )
    return detector


def camera_maker(given: CameraLike, scenario: Scenario) -> Callable[[worlds.World, Truth], Camera]:
    """A function that returns the given camera, or makes one from scenario, world and truth."""

    def make(contents: worlds.World, eye: Truth) -> Camera:
        return part_of("camera", given, scenario, World(scenario, contents), eye)

    return make


def part_of(kind: str, given: _Part | Callable[..., _Part], *of: Any) -> _Part:
    """The given part, or the one that the given class or function makes from ``of``. Raises UserError."""
    methods = _METHODS[kind]
    is_one = not isinstance(given, type) and hasattr(given, methods[0])
    if not is_one and not callable(given):
        raise UserError(f"{kind}: is {given!r:.60}; give a {kind}, its class, or a function that makes one")
    try:
        part: Any = given if is_one else given(*of)  # type: ignore[operator]
    except TypeError as error:
        raise UserError(
            f"{kind}: cannot be made: {error}; see docs/python.md for what it is given"
        ) from error
    missing = [name for name in methods if not hasattr(part, name)]
    if missing:
        raise UserError(f"{kind}: {type(part).__name__} has no {' and no '.join(missing)}")
    return part  # type: ignore[no-any-return]
