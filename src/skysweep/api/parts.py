"""The user's own parts of a mission, as a rig takes them."""

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
    """The name that a scenario has for a strategy, and how it is made. Raises UserError."""
    if isinstance(given, str):
        return given, strategy_spec(given)
    return name_of(given), spec_of(given)


def detector_of(given: Detector | Callable[[Scenario], Detector], scenario: Scenario) -> Detector:
    """A detector, or what a function of the scenario makes. Raises UserError."""
    return _part("detector", given, scenario)


def vehicle_of(given: VehicleLike, scenario: Scenario, seed: int) -> Vehicle:
    """A vehicle, or what a function of scenario and seed makes. Raises UserError."""
    return _part("vehicle", given, scenario, seed)


def camera_maker(given: CameraLike, scenario: Scenario) -> Callable[[worlds.World, Truth], Camera]:
    """What gives the camera of a mission, or makes it of scenario, world and truth."""

    def make(contents: worlds.World, eye: Truth) -> Camera:
        return _part("camera", given, scenario, World(scenario, contents), eye)

    return make


def _part(kind: str, given: _Part | Callable[..., _Part], *of: Any) -> _Part:
    """The part itself, where it is one; else what the class or function makes."""
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
