"""The numbers of one mission, by name. docs/results.md explains them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TypedDict, cast

Limit = float | str  # n_c or d_c; infinity is the string "inf", since JSON has none


class Summary(TypedDict):
    """The numbers of a mission. None means not applicable; without truth nothing can be judged."""

    scenario: str
    strategy: str
    seed: int
    sensor: str | None
    n_c: Limit
    d_c_m: Limit
    completed: bool
    end_reason: str
    mission_time_s: float
    scan_only_time_s: float | None
    return_time_s: float | None
    total_time_s: float
    n_targets: int | None
    n_confirmed: int
    recall: float | None
    time_to_confirm_s: list[float | None] | None  # by target
    pos_curve: list[list[float]] | None  # steps of time s and share confirmed
    n_scanned: int
    n_checks: int
    n_checked: int
    n_unchecked: int
    false_scans: int | None
    false_positives: int | None
    duplicates: int | None
    wrong_rejections: int | None
    median_localisation_error_m: float | None
    path_length_m: float
    vertical_m: float
    energy_wh: float | None
    total_energy_wh: float | None
    battery_remaining: float | None
    sorties: int  # flights, each with a battery
    area_m2: float
    area_covered: float
    area_covered_m2: float
    collisions: int | None
    min_clearance_m: float | None
    wall_time_s: float | None
    real_time_factor: float | None


class RunSummary(Summary):
    """The content of ``summary.json`` without its checksums. The mission may still fly."""

    ended: bool
    n_by_operator: int  # verdicts


def value_of(summary: Summary, key: str) -> Any:
    """A number of a summary whose name is not written out."""
    return cast("Mapping[str, Any]", summary)[key]


def finite_or_inf(value: float) -> Limit:
    """The number itself, as an int where it is whole, or the string ``"inf"``."""
    if math.isinf(value):
        return "inf"
    return int(value) if float(value).is_integer() else float(value)


def plain(node: Any) -> Any:
    """A value that JSON can hold: infinity becomes the string ``"inf"``, NaN null."""
    if isinstance(node, dict):
        return {key: plain(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [plain(value) for value in node]
    if isinstance(node, float) and not math.isfinite(node):
        return None if math.isnan(node) else "inf" if node > 0 else "-inf"
    return node
