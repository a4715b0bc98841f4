"""A mission small enough to check by hand, written as a run folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from skysweep.scenarios.files import write_scenario
from skysweep.scenarios.model import Scenario

NADIR = [0, 1, 0, 1, 0, 0, 0, 0, -1]  # picture's top to the east
EAST_RIGHT = [1, 0, 0, 0, -1, 0, 0, 0, -1]  # picture's top to the north


def scenario_data(**changes: Any) -> dict[str, Any]:
    """40 x 20 m, three signs in a row, one bucket; the picture from 10 m is 20 m x 10 m."""
    data: dict[str, Any] = {
        "name": "tiny",
        "area": {"polygon_enu_m": [[0, 0], [40, 0], [40, 20], [0, 20]]},
        "targets": [{"class": "stop sign", "position_enu_m": [x, 10]} for x in (5, 20, 35)],
        "distractors": [{"class": "red bucket", "position_enu_m": [28, 4]}],
        "camera": {"width_px": 640, "height_px": 320, "hfov_rad": 1.5707963267948966},
        "search": {"n_c": 1, "scan_altitude_agl_m": 10, "check_altitude_agl_m": 2},
    }
    return data | changes


def state(t: float, p: list[float], mode: str = "SCAN", R: list[float] = EAST_RIGHT) -> dict[str, Any]:
    return {
        "t": t,
        "kind": "state",
        "p": p,
        "v": [0, 0, 0],
        "mode": mode,
        "battery": 1 - t / 1000,
        "energy_wh": t / 10,
        "cam": {"p": p, "R": R},
    }


def event(t: float, kind: str, candidate: int | None = None, p: list[float] | None = None) -> dict[str, Any]:
    return {"t": t, "kind": kind, "candidate": candidate, "p": p}


def sighting(
    t: float, candidate: int, p: list[float], confidence: float, new: bool = False
) -> dict[str, Any]:
    return {
        "t": t,
        "kind": "sighting",
        "candidate": candidate,
        "new": new,
        "p": p,
        "confidence": confidence,
        "altitude_agl_m": 10.0,
    }


def tiny_records(t0: float = 0.0) -> list[dict[str, Any]]:
    """Up 10 m, east along y = 10, two descents, home.

    Candidate 1 is the sign at x = 5 (0.5 m off), 2 is a second candidate of it (rejected), 3 is the sign at
    x = 20 (1 m off), 4 the same again (confirmed: a duplicate), 5 the bucket (confirmed: a false alarm),
    6 was only seen. The sign at x = 35 is missed.
    """
    records = [
        {
            "t": 0,
            "kind": "start",
            "scenario": "tiny",
            "strategy": "scan-check",
            "seed": 3,
            "sensor": "imaging",
            "version": "0",
        },
        {"t": 0, "kind": "plan", "waypoints_enu_m": [[0, 10, 10], [40, 10, 10]]},
        state(0, [0, 10, 0], "TAKEOFF"),
        state(10, [0, 10, 10], "SCAN"),
        sighting(11, 1, [5.5, 10, 0], 0.4, new=True),
        event(11, "scanned", 1, [5.5, 10, 0]),
        event(11, "check_started", 1, [5.5, 10, 0]),
        state(15, [5, 10, 2], "CHECK"),
        sighting(15, 1, [5.5, 10, 0], 0.8),
        event(16, "confirmed", 1, [5.5, 10, 0]),
        event(16, "scan_resumed"),
        event(17, "scanned", 2, [5, 12, 0]),
        event(17, "check_started", 2, [5, 12, 0]),
        event(20, "rejected", 2, [5, 12, 0]),
        event(21, "scan_resumed"),
        state(30, [5, 10, 10], "SCAN"),
        state(35, [20, 10, 10], "SCAN"),
        event(36, "scanned", 3, [20, 11, 0]),
        event(36, "check_started", 3, [20, 11, 0]),
        event(40, "confirmed", 3, [20, 11, 0]),
        event(44, "confirmed", 4, [20.5, 10, 0]),
        event(50, "confirmed", 5, [28, 4, 0]),
        sighting(55, 6, [38, 18, 0], 0.3, new=True),
        event(60, "finished"),
        state(60, [20, 10, 10], "RETURN"),
        state(70, [0, 10, 10], "RETURN"),
        state(80, [0, 10, 0], "LAND"),
        {"t": 80, "kind": "landed"},
        {"t": 80, "kind": "end", "reason": "completed"},
    ]
    return [r | {"t": r["t"] + t0} for r in records]


def write_run(folder: Path, records: list[dict[str, Any]], **changes: Any) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    write_scenario(Scenario.model_validate(scenario_data(**changes)), folder / "config.yaml")
    (folder / "journal.jsonl").write_text("".join(json.dumps(r) + "\n" for r in records))
    return folder
