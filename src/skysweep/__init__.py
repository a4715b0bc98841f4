"""skysweep plans, simulates, compares and flies UAV search-and-rescue missions.

``import skysweep as ss`` offers the names in ``__all__``; each is imported when it is asked for. What is not
there is private and may change at any time, but for what docs/python.md excepts.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from skysweep.caching import prepare_numba_cache

if TYPE_CHECKING:
    from skysweep.api.detection import ImageDetector as ImageDetector
    from skysweep.api.detection import load_detector as load_detector
    from skysweep.api.flying import run as run
    from skysweep.api.planning import Plan as Plan
    from skysweep.api.planning import plan as plan
    from skysweep.api.runs import KeptFrame as KeptFrame
    from skysweep.api.runs import Run as Run
    from skysweep.api.runs import load_run as load_run
    from skysweep.api.scenarios import change_scenario as change_scenario
    from skysweep.api.scenarios import load_scenario as load_scenario
    from skysweep.api.scenarios import make_scenario as make_scenario
    from skysweep.api.sweeps import compare as compare
    from skysweep.api.sweeps import estimate as estimate
    from skysweep.api.sweeps import sweep as sweep
    from skysweep.api.worlds import World as World
    from skysweep.api.worlds import build_world as build_world
    from skysweep.api.worlds import camera_pose as camera_pose
    from skysweep.errors import UserError as UserError
    from skysweep.geometry.camera import CameraMotion as CameraMotion
    from skysweep.geometry.camera import CameraPose as CameraPose
    from skysweep.geometry.camera import Lens as Lens
    from skysweep.results.reporting.statistics import Estimate as Estimate
    from skysweep.results.reporting.statistics import PairedTest as PairedTest
    from skysweep.scenarios.files import list_scenarios as list_scenarios
    from skysweep.scenarios.files import write_scenario as write_scenario
    from skysweep.scenarios.model import Area as Area
    from skysweep.scenarios.model import Building as Building
    from skysweep.scenarios.model import CameraModel as CameraModel
    from skysweep.scenarios.model import DetectorModel as DetectorModel
    from skysweep.scenarios.model import Distractor as Distractor
    from skysweep.scenarios.model import Forest as Forest
    from skysweep.scenarios.model import Generator as Generator
    from skysweep.scenarios.model import Gimbal as Gimbal
    from skysweep.scenarios.model import Home as Home
    from skysweep.scenarios.model import Light as Light
    from skysweep.scenarios.model import Safety as Safety
    from skysweep.scenarios.model import Scenario as Scenario
    from skysweep.scenarios.model import Search as Search
    from skysweep.scenarios.model import Target as Target
    from skysweep.scenarios.model import Terrain as Terrain
    from skysweep.scenarios.model import Tree as Tree
    from skysweep.scenarios.model import VehicleLimits as VehicleLimits
    from skysweep.scenarios.model import Wind as Wind
    from skysweep.strategies.context import MissionContext as MissionContext
    from skysweep.types import Camera as Camera
    from skysweep.types import Candidate as Candidate
    from skysweep.types import Command as Command
    from skysweep.types import Detections as Detections
    from skysweep.types import Detector as Detector
    from skysweep.types import Event as Event
    from skysweep.types import EventKind as EventKind
    from skysweep.types import Frame as Frame
    from skysweep.types import Look as Look
    from skysweep.types import Mode as Mode
    from skysweep.types import Observation as Observation
    from skysweep.types import Setpoint as Setpoint
    from skysweep.types import Sighting as Sighting
    from skysweep.types import Strategy as Strategy
    from skysweep.types import Truth as Truth
    from skysweep.types import Vehicle as Vehicle
    from skysweep.types import VehicleState as VehicleState
    from skysweep.types import Waypoint as Waypoint
    from skysweep.vehicles.embedded.at_home import embedded_vehicle as embedded_vehicle

__version__ = "0.1.0"

_PUBLIC = {
    "api.detection": ("ImageDetector", "load_detector"),
    "api.flying": ("run",),
    "api.planning": ("Plan", "plan"),
    "api.runs": ("KeptFrame", "Run", "load_run"),
    "api.scenarios": ("change_scenario", "load_scenario", "make_scenario"),
    "api.sweeps": ("compare", "estimate", "sweep"),
    "api.worlds": ("World", "build_world", "camera_pose"),
    "errors": ("UserError",),
    "geometry.camera": ("CameraMotion", "CameraPose", "Lens"),
    "results.reporting.statistics": ("Estimate", "PairedTest"),
    "scenarios.files": ("list_scenarios", "write_scenario"),
    "scenarios.model": (
        *("Area", "Building", "CameraModel", "DetectorModel", "Distractor", "Forest", "Generator", "Gimbal"),
        *("Home", "Light", "Safety", "Scenario", "Search", "Target", "Terrain", "Tree", "VehicleLimits"),
        "Wind",
    ),
    "strategies.context": ("MissionContext",),
    "types": (
        *("Camera", "Candidate", "Command", "Detections", "Detector", "Event", "EventKind", "Frame"),
        *(
            "Look",
            "Mode",
            "Observation",
            "Setpoint",
            "Sighting",
            "Strategy",
            "Truth",
            "Vehicle",
            "VehicleState",
            "Waypoint",
        ),
    ),
    "vehicles.embedded.at_home": ("embedded_vehicle",),
}
_MODULE_OF = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = sorted(_MODULE_OF)

prepare_numba_cache()


def __getattr__(name: str) -> Any:
    """A public name, imported now (PEP 562)."""
    module = _MODULE_OF.get(name)
    if module is None:
        raise AttributeError(f"module 'skysweep' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"skysweep.{module}"), name)
    return value


def __dir__() -> list[str]:
    """The public names."""
    return [*__all__, "__version__"]
