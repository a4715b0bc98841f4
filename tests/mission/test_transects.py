"""Long transects are flown where they were planned."""

import math

import numpy as np
import pytest

from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.sight import foot_point
from skysweep.scenarios.model import Scenario
from skysweep.types import Mode

SETTLED_M = 40.0  # behind the turn at a transect's start


@pytest.mark.parametrize("strategy", ["scan-only", "belief"])
@pytest.mark.parametrize("hills_m", [0.0, 30.0])
def test_wind_and_turns_take_the_vehicle_off_no_transect(strategy, hills_m):
    """Straight to its end it is up to 11 m beside it. Belief is to look at nothing again."""
    parameters = {"parameters": {"missed_cost_s": 1.0}} if strategy == "belief" else {}
    rows = hills_m * np.sin(np.linspace(0.0, 4.0 * math.pi, 60))[:, None].repeat(20, axis=1)
    scenario = Scenario.model_validate(
        {
            "name": "hills",
            "area": {"polygon_enu_m": [[0, 0], [140, 0], [140, 500], [0, 500]]},
            "terrain": {"heightmap_m": rows.tolist()},
            "wind": {"mean_speed_mps": 5.0, "from_heading_deg": 90.0},
            "vehicle": {"cruise_speed_mps": 10.0, "battery_wh": 5000.0},
            "search": {
                "strategy": strategy,
                "scan_altitude_agl_m": 60.0,
                "scan_speed_mps": 8.0,
                "transect_heading_deg": 0.0,
                **parameters,
            },
        }
    )
    plan, _ = plan_scenario(scenario)
    assert bool(plan.profiles) == (hills_m > 0.0)
    off_m, below_m = [], []
    with Flight(build_mission(scenario, 0, Rig("statistical")), MemoryJournal()) as flight:
        for tick in flight:
            east_m, north_m, height_m = tick.state.position_enu_m.tolist()
            for k, leg in enumerate(plan.transects):
                x, y, share = foot_point(np.asarray(leg), east_m, north_m)
                away_m, length_m = math.dist((east_m, north_m), (x, y)), math.dist(*leg.tolist())
                settled = SETTLED_M < share * length_m < length_m - 10.0
                if tick.mode is Mode.SCAN and settled and away_m < 30.0:
                    off_m.append(away_m)
                    if plan.profiles:
                        profile = plan.profiles[k]
                        planned_m = np.interp(share * length_m, profile.along_m, profile.height_m)
                        below_m.append(planned_m - height_m)
    assert len(off_m) > 300
    assert max(off_m) < 3.0
    assert max(below_m, default=0.0) < 0.5
