"""Real missions with the statistical sensor in the table that a sweep leaves behind."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import polars as pl

from skysweep.flights.fly import fly_in_memory
from skysweep.scenarios.files import change_scenario, dump_scenario
from skysweep.scenarios.model import Scenario

ON_THE_CLOCK = ("wall_time_s", "real_time_factor")


def tiny_scenario(**changes: Any) -> Scenario:
    """40 m x 30 m with three signs and a bucket, which a mission searches in about a minute."""
    data = {
        "name": "tiny",
        "area": {"polygon_enu_m": [[0, 0], [40, 0], [40, 30], [0, 30]]},
        "targets": [{"class": "stop sign", "position_enu_m": [x, 12]} for x in (8, 20, 33)],
        "distractors": [{"class": "red bucket", "position_enu_m": [26, 22]}],
        "scatter_m": 4.0,
        "search": {"scan_altitude_agl_m": 14, "check_altitude_agl_m": 4},
    }
    return Scenario.model_validate(data | changes)


def fly_sweep(
    scenarios: Mapping[str, Scenario],
    parameters: Mapping[str, Sequence[Any]],
    seeds: int,
    strategies: Sequence[str] = ("scan-check",),
) -> pl.DataFrame:
    """The cartesian product, flown: one row a mission, as ``missions.parquet`` holds them."""
    rows = []
    for scenario, strategy, *values in itertools.product(scenarios, strategies, *parameters.values()):
        chosen = dict(zip(parameters, values, strict=True))
        changed = change_scenario(scenarios[scenario], chosen | {"search.strategy": strategy})
        for seed in range(seeds):
            rows.append(_row(len(rows), scenario, changed, seed, chosen))
    return pl.DataFrame(rows, infer_schema_length=None)


def _row(job: int, label: str, scenario: Scenario, seed: int, chosen: dict[str, Any]) -> dict[str, Any]:
    summary = fly_in_memory(scenario, seed)
    curve = summary.pop("pos_curve") or ()
    kept = {k: math.inf if v == "inf" else v for k, v in summary.items() if k not in ON_THE_CLOCK}
    return (
        {"job": job}
        | kept
        | {"scenario": label, "n_c": float(kept["n_c"]), "d_c_m": float(kept["d_c_m"]), "error": None}
        | {"config_hash": hashlib.sha256(f"{dump_scenario(scenario)}|{seed}".encode()).hexdigest()[:16]}
        | {f"param.{field}": value for field, value in chosen.items()}
        | {"pos_time_s": [p[0] for p in curve], "pos_value": [p[1] for p in curve]}
    )
