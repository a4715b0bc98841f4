"""The embedded vehicle against logs of a PX4 v1.17 flying its SIH quadrotor."""

from pathlib import Path

import pytest

from skysweep.vehicles.calibration import Flown, fly_again, read_log

LOGS = Path(__file__).parents[1] / "data" / "px4_sih"
TOLERANCE = 0.10


def fly(name: str) -> tuple[Flown, Flown]:
    return fly_again(read_log(LOGS / f"{name}.csv.gz"))


@pytest.mark.parametrize(
    "name",
    [f"step50_vmax{v}_{run}" for v in (12, 5) for run in (0, 1, 2)]
    + ["kdv03_step50_vmax12_0", "kdv03_step50_vmax5_0"],
)
def test_horizontal_steps(name: str) -> None:
    logged, ours = fly(name)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)
    assert ours.peak_tilt_deg == pytest.approx(logged.peak_tilt_deg, rel=TOLERANCE)


@pytest.mark.parametrize("name", [f"{way}20_step_{run}" for way in ("climb", "descent") for run in (0, 1, 2)])
def test_climbs_and_descents(name: str) -> None:
    """Their logged tilt, 2 to 6 degrees, is PX4 chasing its estimator's noise and is not compared."""
    logged, ours = fly(name)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)


@pytest.mark.parametrize("name", ["carrot50_5ms_0", "carrot50_5ms_2", "lawnmower_4x60_15_step_5ms"])
def test_peaks_of_moving_setpoints_and_turns(name: str) -> None:
    logged, ours = fly(name)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
    assert ours.peak_speed_mps == pytest.approx(logged.peak_speed_mps, rel=TOLERANCE)
    assert ours.peak_tilt_deg == pytest.approx(logged.peak_tilt_deg, rel=TOLERANCE)


@pytest.mark.parametrize(
    "name",
    [f"lawnmower_4x60_15_{kind}_{v}ms" for kind in ("step", "carrot") for v in (5, 1)]
    + ["square_50m_20m_5ms"],
)
def test_total_time_of_patterns(name: str) -> None:
    logged, ours = fly(name)
    assert ours.time_s == pytest.approx(logged.time_s, rel=TOLERANCE)
