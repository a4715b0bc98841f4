"""Shipped scenarios flown with the statistical sensor, and what the camera watch says of pictures on the way.

    python tests/mission/camera_flights.py                                   # all, seeds 0 and 1: 15 minutes
    python tests/mission/camera_flights.py clusters --seeds 0 --off-deg 6    # with a compass that is off
    python tests/mission/camera_flights.py person-wilderness --set search.strategy=belief  # fields

Prints how many pictures were doubted, and how often the camera was trusted again.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from skysweep.cli.common import changes_of
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.geometry.frames import rotation_from_euler
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import fly
from skysweep.scenarios.files import change_scenario, list_scenarios, load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.camera_watch import CameraWatch
from skysweep.sensing.cameras.rendered import RenderedCamera
from skysweep.sensing.exposures import Exposures
from skysweep.types import Detections, Doubt, Sensor, VehicleState
from skysweep.vehicles.embedded.multirotor import Multirotor
from skysweep.worlds.obstacles import known_obstacles
from skysweep.worlds.world import build_world


class WatchedSensor:
    """A sensor, and beside it a camera whose pictures are judged with a compass that is off by each angle."""

    def __init__(
        self, sensor: Sensor, vehicle: Multirotor, scenario: Scenario, seed: int, off_deg: Sequence[float]
    ) -> None:
        self._sensor = sensor
        camera = scenario.camera
        self._camera = RenderedCamera(build_world(scenario, seed), camera, vehicle, seed)
        self._exposures = Exposures(min(scenario.detector.rate_hz, camera.rate_hz), camera.pose_delay_s)
        self._turns = [rotation_from_euler(0.0, 0.0, math.radians(deg)) for deg in off_deg]
        self._watches = [CameraWatch(known_obstacles(scenario)) for _ in off_deg]
        self.doubts: list[list[Doubt | None]] = [[] for _ in off_deg]  # of each picture

    def sense(self, state: VehicleState) -> Detections | None:
        believed = self._exposures.due(state)
        if believed is not None:
            frame = self._camera.capture(state._replace(camera=believed))
            for turn, watch, doubts in zip(self._turns, self._watches, self.doubts, strict=True):
                turned = believed._replace(R_camera_to_enu=turn @ believed.R_camera_to_enu)
                doubts.append(watch.judge(replace(frame, camera=turned), state.R_body_to_enu[:, 2]))
        return self._sensor.sense(state)

    def close(self) -> None:
        self._sensor.close()
        self._camera.close()


def doubts_on_the_way(scenario: Scenario, seed: int, off_deg: Sequence[float]) -> list[list[Doubt | None]]:
    """For each angle what the watch says of the pictures of a mission."""
    mission = build_mission(scenario, seed, Rig("statistical"))
    assert isinstance(mission.vehicle, Multirotor)
    sensor = WatchedSensor(mission.sensor, mission.vehicle, scenario, seed, off_deg)
    fly(replace(mission, sensor=sensor), MemoryJournal())
    return sensor.doubts


def times_trusted_again(doubts: list[Doubt | None]) -> int:
    return sum(before is not None and now is None for before, now in pairwise(doubts))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenarios", nargs="*", default=list_scenarios())
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--off-deg", type=float, default=0.0)
    parser.add_argument("--set", nargs="+", default=[], dest="fields", metavar="FIELD=VALUE")
    options = parser.parse_args()
    changes = changes_of(options.fields)
    for name in options.scenarios:
        for seed in options.seeds:
            scenario = change_scenario(load_scenario(name), changes)
            (doubts,) = doubts_on_the_way(scenario, seed, [options.off_deg])
            whys = sorted({doubt.why.split(":")[0] for doubt in doubts if doubt is not None})
            n_doubted = sum(doubt is not None for doubt in doubts)
            print(
                f"{name} {seed}: {len(doubts)} pictures, {n_doubted} doubted, "
                f"{times_trusted_again(doubts)} times trusted again {whys}",
                flush=True,
            )


if __name__ == "__main__":
    main()
