"""A mission on a PX4, into a run folder."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skysweep.errors import UserError
from skysweep.experiments.rehearsal import rehearse
from skysweep.experiments.resume import resume_folder
from skysweep.experiments.single import Say, Watch, fly_to_folder
from skysweep.mission.loop import Operator
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.plan_files import plan_of_mission
from skysweep.scenarios.model import Scenario
from skysweep.scenarios.world import build_terrain
from skysweep.sensing.video_camera import VideoCamera
from skysweep.strategies import strategy_spec
from skysweep.types import Camera
from skysweep.vehicles.px4 import Px4Vehicle
from skysweep.vehicles.px4_preflight import Check, preflight
from skysweep.vehicles.signed_link import SignedLink

if TYPE_CHECKING:
    from skysweep.sensing.render import Backend

RENDERED = "rendered"
_MOTORS_STOP_S = 20.0  # on the wall, after landing


class Px4Flight:
    """A scenario and the PX4 that will fly it. A context manager: its end hands the vehicle over to Hold.

    With a ``signing_key`` (32 bytes) every frame is signed, and only those that the vehicle signs are heard.

    Raises UserError, before anything is connected, where the scenario cannot be flown, and where no fitting
    vehicle answers at ``url`` in ``timeout_s``.
    """

    def __init__(
        self, scenario: Scenario, url: str, timeout_s: float, signing_key: bytes | None = None
    ) -> None:
        self._altitude_agl_m = strategy_spec(scenario.search.strategy).cover_altitude_agl_m(scenario.search)
        plan_scenario(scenario, self._altitude_agl_m)
        height_m = build_terrain(scenario).height_m
        self._ending = ExitStack()
        if signing_key is None:
            self.vehicle = Px4Vehicle(url, scenario, height_m, timeout_s)
        else:
            link = self._ending.enter_context(closing(SignedLink(url, signing_key, timeout_s)))
            try:
                self.vehicle = Px4Vehicle(link.url, scenario, height_m, timeout_s)
            except UserError as error:
                self._ending.close()
                if link.refused == 0 or link.accepted > 0:
                    raise UserError(str(error).replace(link.url, url)) from None
                raise UserError(
                    f"--connection {url}: {link.refused} frames were heard, and not signed with this key; "
                    "give the key that the vehicle signs with, set it up to sign, or set its clock"
                ) from None
            except BaseException:
                self._ending.close()
                raise
        self.scenario = self.vehicle.scenario

    def preflight(self, upload: bool) -> tuple[Check, ...]:
        """The list to read before arming; with ``upload`` the fence and the rally points are sent."""
        coverage, estimate = plan_scenario(self.scenario, self._altitude_agl_m)
        share = estimate.energy_wh / self.scenario.vehicle.battery_wh
        return preflight(self.vehicle, plan_of_mission(self.scenario, coverage), share, upload)

    def rehearse(self, camera_source: str, renderer: Backend, threads: int) -> Check:
        """How often camera and detector look on this computer; a line of the list."""
        camera = self.open_camera(camera_source)
        return rehearse(self.scenario, self.vehicle, camera, renderer, threads)

    def fly(
        self,
        seed: int,
        out: Path,
        sensor_name: str,
        camera_source: str,
        renderer: Backend,
        threads: int,
        watch: Watch,
        operator: Operator,
        say: Say = lambda _words: None,
    ) -> dict[str, Any]:
        """Arm, fly the mission and land; the summary of its run folder."""
        camera = self.open_camera(camera_source) if sensor_name == "imaging" else None
        summary = fly_to_folder(
            self.scenario,
            seed,
            out,
            sensor_name,
            renderer,
            threads,
            watch,
            self.vehicle,
            camera,
            operator,
            say=say,
        )
        self.vehicle.wait_disarmed(_MOTORS_STOP_S)
        return summary

    def resume(
        self,
        folder: Path,
        camera_source: str,
        watch: Watch,
        operator: Operator,
        say: Say = lambda _words: None,
    ) -> dict[str, Any]:
        """Go on with a flight that was broken off, from where the vehicle is; the summary of its folder."""
        camera = self.open_camera(camera_source)
        summary = resume_folder(
            folder, watch, vehicle=self.vehicle, camera=camera, operator=operator, say=say
        )
        self.vehicle.wait_disarmed(_MOTORS_STOP_S)
        return summary

    def open_camera(self, source: str) -> Camera | None:
        """The camera of that name, None for the rendered one. Raises UserError where it shows nothing."""
        lens = self.scenario.camera.lens
        if source == RENDERED:
            return None
        if source.startswith(("gazebo:", "gz:")):
            from skysweep.gazebo.live import LiveCamera

            return LiveCamera(source, lens)
        if source.startswith("ros:"):
            from skysweep.ros.link import Link
            from skysweep.ros.parts import RosCamera

            link = self._ending.enter_context(closing(Link("mission")))
            return RosCamera(link, source.removeprefix("ros:"), lens)
        return VideoCamera(source, lens)

    def __enter__(self) -> Px4Flight:
        return self

    def __exit__(self, *_: object) -> None:
        with self._ending:
            self.vehicle.close()
