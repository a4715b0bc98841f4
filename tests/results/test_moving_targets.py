"""A target that moves is found where it was when it was looked at."""

from __future__ import annotations

from skysweep.flights.fly import fly_in_memory
from skysweep.scenarios.model import Scenario


def mission(motion):
    return Scenario.model_validate(
        {
            "name": "walker",
            "area": {"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]},
            "targets": [
                {"class": "person", "pose": "lying", "position_enu_m": [20, 20], "motion": motion},
            ],
            "camera": {"hfov_rad": 1.2},
            "search": {
                "n_c": 1,
                "scan_altitude_agl_m": 25,
                "check_altitude_agl_m": 10,
                "c_t": 0.3,
                "target_speed_mps": 0.25,
            },
        }
    )


def test_a_slow_mover_is_found_far_from_where_it_began():
    motion = {"kind": "path", "waypoints_enu_m": [[50, 20]], "speed_mps": 0.25}
    moved = [fly_in_memory(mission(motion), seed, "statistical") for seed in range(3)]
    assert sum(s["recall"] for s in moved) >= 2
    found = [s for s in moved if s["recall"]]
    assert all(s["median_localisation_error_m"] < 2.0 for s in found)
    assert all(0.25 * s["time_to_confirm_s"][0] > 4.0 for s in found)  # beyond a match at its start
