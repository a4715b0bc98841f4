"""Flies a mission on a PX4 into a run folder."""

from __future__ import annotations

import json
import os
import shutil
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import asdict, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from skysweep.errors import CannotWriteError, UserError
from skysweep.files.writing import make_folder
from skysweep.flights.fly import fly_to_folder, refuse_other_mission
from skysweep.flights.rehearsal import rehearse
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.mission.orders import HOLD, MOST_WAITING, RETURN, STEERING, Operator, Order
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.plan_files import plan_of_mission
from skysweep.results.summary import RunSummary
from skysweep.scenarios.model import Scenario
from skysweep.sensing.cameras.video import VideoCamera
from skysweep.strategies import strategy_spec
from skysweep.types import Camera
from skysweep.vehicles.px4.preflight import Check, Demands, preflight
from skysweep.vehicles.px4.signed_link import SignedLink
from skysweep.vehicles.px4.vehicle import Px4Vehicle
from skysweep.worlds.obstacles import known_obstacles
from skysweep.worlds.world import build_terrain

if TYPE_CHECKING:
    from skysweep.worlds.rendering.renderer import Backend

RENDERED = "rendered"
_MOTORS_STOP_S = 20.0  # on the wall, after landing
_PARAMETERS_S = 30.0  # on the wall, for a slow radio
_BESIDE_M = 10.0  # half the width of the autopilot's own way home
_STEP_M = 5.0  # between samples of the terrain
_LITTLE_BYTES, _FEW_BYTES = 50e6, 1e9


class Px4Flight:
    """A scenario and the PX4 that will fly it. A context manager: its end hands the vehicle over to Hold.

    With a ``signing_key`` (32 bytes) every sent frame is signed, and received frames must be.

    Raises UserError before connecting if the scenario cannot be flown, and if no suitable vehicle answers at
    ``url`` in ``timeout_s``.
    """

    def __init__(
        self,
        scenario: Scenario,
        url: str,
        timeout_s: float,
        signing_key: bytes | None = None,
        system_id: int | None = None,
    ) -> None:
        self._checks: tuple[Check, ...] = ()
        self._parameters: dict[str, float] = {}
        self._ros: Any = None  # the node of a camera on a topic
        self._altitude_agl_m = strategy_spec(scenario.search.strategy).cover_altitude_of(scenario)
        plan_scenario(scenario, self._altitude_agl_m)
        height_m = build_terrain(scenario).height_m
        with ExitStack() as ending:
            link = None
            if signing_key is not None:
                link = ending.enter_context(closing(SignedLink(url, signing_key, timeout_s)))
            try:
                self.vehicle = Px4Vehicle(link.url if link else url, scenario, height_m, timeout_s, system_id)
            except UserError as error:
                if link is None:
                    raise
                if link.refused == 0 or link.accepted > 0:
                    raise UserError(str(error).replace(link.url, url)) from None
                raise UserError(
                    f"--connection {url}: {link.refused} frames were received, none signed with this key; "
                    "give the vehicle's key, set the vehicle up to sign, or set its clock and ours"
                ) from None
            self._ending = ending.pop_all()
        self.scenario = self.vehicle.scenario

    def preflight(self, upload: bool, folder: Path) -> tuple[Check, ...]:
        """The list to read before arming; with ``upload`` fence and rally points are sent.

        ``folder`` is the future run folder.
        """
        self._checks = (*preflight(self.vehicle, self._demands(), upload), _storage(folder))
        self._parameters = self.vehicle.link.parameters(_PARAMETERS_S)
        return self._checks

    def _demands(self) -> Demands:
        scenario = self.scenario
        coverage, estimate = plan_scenario(scenario, self._altitude_agl_m)
        home = np.array(scenario.home.position_enu_m, dtype=float)
        places = np.vstack([coverage.waypoints_xy_enu_m, home])
        obstacles = known_obstacles(scenario)
        terrain = obstacles.terrain
        home_m = float(terrain.height_m(home[None])[0])
        ways = _along(places, home)
        ground_m = float(terrain.height_m(ways).max()) - home_m
        top_m = float(obstacles.top_within_m(ways, _BESIDE_M).max(initial=-np.inf)) - home_m
        return Demands(
            plan_of_mission(scenario, coverage),
            estimate,
            float(np.linalg.norm(places - home, axis=1).max()),
            ground_m + self._altitude_agl_m,
            max(ground_m, top_m) + scenario.safety.clearance_m,
        )

    def rehearse(self, camera_source: str, renderer: Backend, threads: int) -> Check:
        """The rate of camera and detector on this computer, as a line of the list."""
        try:
            camera = self.open_camera(camera_source)
            rig = Rig(renderer=renderer, threads=threads, vehicle=self.vehicle, camera=camera)
            check = rehearse(self.scenario, rig)
        except UserError as error:
            check = Check("detector", False, str(error))
        self._checks += (check,)
        return check

    def fly(self, seed: int, out: Path, camera_source: str, rig: Rig) -> RunSummary:
        """Arm, fly the mission with this vehicle and land; the summary of its run folder."""
        refuse_other_mission(out)
        with self._rigged(out, camera_source, rig) as rigged:
            return fly_to_folder(self.scenario, seed, out, rigged)

    def resume(
        self, folder: Path, camera_source: str, rig: Rig, from_sound_lines: bool = False
    ) -> RunSummary:
        """Resume an interrupted flight from where the vehicle is; the summary of its folder.

        ``from_sound_lines`` is as in ``resume_folder``.
        """
        with self._rigged(folder, camera_source, rig) as rigged:
            return resume_folder(folder, rigged, from_sound_lines)

    @contextmanager
    def _rigged(self, folder: Path, camera_source: str, rig: Rig) -> Iterator[Rig]:
        """Keeps the record, adds vehicle and camera to the rig, and after the flight waits for the motors."""
        self._keep_record(folder)
        self.vehicle.advance(0.0)
        camera = self.open_camera(camera_source) if rig.sensor == "imaging" else None
        operator = _Waiting(rig.operator)
        self.vehicle.is_called_off = operator.calls_off
        yield replace(rig, vehicle=self.vehicle, camera=camera, operator=operator)
        self.vehicle.wait_disarmed(_MOTORS_STOP_S)

    def _keep_record(self, folder: Path) -> None:
        """Writes the list, the autopilot's version and its parameters into a new file."""
        record = {
            "utc": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "autopilot": self.vehicle.link.newest("AUTOPILOT_VERSION"),
            "checks": [asdict(check) for check in self._checks],
            "parameters": self._parameters,
        }
        make_folder(folder)
        names = (folder / f"preflight{k}.json" for k in ("", *(f"-{n}" for n in range(2, 10_000))))
        path = next(path for path in names if not os.path.lexists(path))
        try:
            path.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise CannotWriteError(folder, error) from None

    def open_camera(self, source: str) -> Camera | None:
        """The camera of a source; None for the rendered one. Raises UserError if it shows nothing."""
        lens = self.scenario.camera.lens
        if source == RENDERED:
            return None
        if source.startswith(("gazebo:", "gz:")):
            from skysweep.gazebo.live import LiveCamera

            return LiveCamera(source, lens)
        if source.startswith("ros:"):
            from skysweep.ros.link import RosLink
            from skysweep.ros.parts import RosCamera

            self._ros = self._ros or self._ending.enter_context(closing(RosLink("mission")))
            return RosCamera(self._ros, source.removeprefix("ros:"), lens)
        return VideoCamera(source, lens)

    def __enter__(self) -> Px4Flight:
        return self

    def __exit__(self, *_: object) -> None:
        with self._ending:
            self.vehicle.close()


class _Waiting:
    """An operator whose orders can be looked at before the mission asks for them."""

    def __init__(self, operator: Operator) -> None:
        self._operator = operator
        self._orders: deque[Order] = deque()

    def __call__(self) -> Order | None:
        return self._orders.popleft() if self._orders else self._operator()

    def calls_off(self) -> bool:
        """Whether the newest word that steers is against a take-off."""
        while len(self._orders) < MOST_WAITING and (order := self._operator()) is not None:
            self._orders.append(order)
        words = [order.word for order in self._orders if order.word in STEERING]
        return bool(words) and words[-1] in (HOLD, RETURN)


def _along(places_xy_m: NDArray[np.float64], home_xy_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2) samples of the straight ways from each place to home."""
    steps = max(2, int(np.linalg.norm(places_xy_m - home_xy_m, axis=1).max() / _STEP_M))
    shares = np.linspace(0.0, 1.0, steps)[:, None, None]
    return (home_xy_m + shares * (places_xy_m - home_xy_m)).reshape(-1, 2)


def _storage(folder: Path) -> Check:
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free
    passed = False if free < _LITTLE_BYTES else None if free < _FEW_BYTES else True
    return Check("storage", passed, f"{free / 1e9:.1f} GB free for the run")
