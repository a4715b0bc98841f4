"""The embedded vehicle against logs of a PX4 v1.17 flying its SIH quadrotor.

FlownManoeuvre with exact estimates, and again under the estimation errors that the log shows.
"""

from pathlib import Path

import numpy as np
import pytest

from skysweep.scenarios.model import CameraModel, VehicleLimits, Wind
from skysweep.vehicles.embedded.calibration import FlownManoeuvre, fly_again, read_log
from skysweep.vehicles.embedded.multirotor import Multirotor

LOGS = Path(__file__).parents[1] / "data" / "px4_sih"
TOLERANCE = 0.10


def fly(name: str, exact: bool) -> tuple[FlownManoeuvre, FlownManoeuvre]:
    log = read_log(LOGS / f"{name}.csv.gz")
    return fly_again(log.exact() if exact else log)


both = pytest.mark.parametrize("exact", [True, False], ids=["exact", "as_estimated"])


@both
@pytest.mark.parametrize(
    "name",
    [f"step50_vmax{v}_{run}" for v in (12, 5) for run in (0, 1, 2)]
    + ["kdv03_step50_vmax12_0", "kdv03_step50_vmax5_0"],
)
def test_horizontal_steps(name: str, exact: bool) -> None:
    logged, ours = fly(name, exact)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)
    assert ours.peak_tilt_deg == pytest.approx(logged.peak_tilt_deg, rel=TOLERANCE)


@both
@pytest.mark.parametrize("name", [f"{way}20_step_{run}" for way in ("climb", "descent") for run in (0, 1, 2)])
def test_climbs_and_descents(name: str, exact: bool) -> None:
    logged, ours = fly(name, exact)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)


@pytest.mark.parametrize(
    ("name", "px4_s"),
    [
        ("climb20_step_0", 8.28),
        ("climb20_step_1", 8.38),
        ("climb20_step_2", 8.20),
        ("descent20_step_0", 13.50),
        ("descent20_step_1", 15.02),
        ("descent20_step_2", 13.70),
    ],
)
def test_climbs_and_descents_enter_the_sphere(name: str, px4_s: float) -> None:
    """PX4's times to within 0.5 m in space, measured at 50 Hz while it flew; the logs have half the rows."""
    logged, ours = fly(name, exact=False)
    assert logged.sphere_time_s == pytest.approx(px4_s, abs=0.05)
    assert ours.sphere_time_s == pytest.approx(px4_s, rel=0.05)
    assert ours.time_s == pytest.approx(logged.time_s, rel=0.05)


@both
@pytest.mark.parametrize("name", ["carrot50_5ms_0", "carrot50_5ms_2", "lawnmower_4x60_15_step_5ms"])
def test_peaks_of_moving_setpoints_and_turns(name: str, exact: bool) -> None:
    logged, ours = fly(name, exact)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)
    assert ours.peak_tilt_deg == pytest.approx(logged.peak_tilt_deg, rel=TOLERANCE)


PATTERNS = [
    *(f"lawnmower_4x60_15_{kind}_{v}ms" for kind in ("step", "carrot") for v in (5, 1)),
    "square_50m_20m_5ms",
]


@both
@pytest.mark.parametrize("name", PATTERNS)
def test_total_time_of_patterns(name: str, exact: bool) -> None:
    logged, ours = fly(name, exact)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)


@pytest.mark.parametrize("name", PATTERNS)
def test_peaks_of_patterns_under_px4s_estimates(name: str) -> None:
    logged, ours = fly(name, exact=False)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)
    assert ours.peak_tilt_deg == pytest.approx(logged.peak_tilt_deg, rel=TOLERANCE)


@pytest.mark.parametrize("name", PATTERNS)
def test_logged_estimates_err_as_px4s_filter_must(name: str) -> None:
    """Standard deviations worked out from EKF2's gains and SIH's sensor noise (docs/vehicle.md)."""
    log = read_log(LOGS / f"{name}.csv.gz")
    assert log.velocity_error_enu_mps.std(axis=0) == pytest.approx([0.26, 0.13, 0.12], rel=0.4)


def test_lands_as_px4_does_under_its_estimates() -> None:
    """From 20 m to 0.5 m: PX4 took 22.5 s; with exact estimates it would be 18 s."""
    log = read_log(LOGS / "square_50m_20m_5ms.csv.gz")
    start = log.legs[-1].stop
    logged_s = log.time_s[start:] - log.time_s[start]
    px4_s = logged_s[np.argmax(log.position_enu_m[start:, 2] < 0.5)]
    still_air = Wind(mean_speed_mps=0.0, gust_std_mps=0.0)
    exact = VehicleLimits(position_noise_m=0.0, attitude_noise_deg=0.0)
    vehicle = Multirotor(exact, still_air, CameraModel(), np.zeros(3), lambda x, y: 0.0, 0)
    vehicle.place(log.position_enu_m[start], log.velocity_enu_mps[start], log.yaw_rad[start])
    vehicle.land()
    landed_s = 0.0
    while vehicle.true_position_enu_m[2] > 0.5:
        row = start + int(np.searchsorted(logged_s, landed_s + 1e-6)) - 1
        vehicle.misjudge(log.velocity_error_enu_mps[row], log.lean_error[row])
        vehicle.advance(0.04)
        landed_s += 0.04
    assert landed_s == pytest.approx(px4_s, rel=TOLERANCE)
