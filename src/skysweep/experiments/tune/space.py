"""The parameters that a tuning may change, and the values that each may take.

Each parameter is an ascending list of round values, infinity last. The values suit the scenario and its
camera: altitudes from which a target spans enough pixels, and speeds that the vehicle can fly. Values that
``planning.advice`` warns about are left out. The scenario's own value is always included.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from skysweep.errors import UserError
from skysweep.files.models import leaf_fields, union_arms
from skysweep.planning.advice import UNSEEN_BELOW_PX, WISHED_AT_CHECK_PX, warnings_for
from skysweep.scenarios.files import change_scenario
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.strategies.fields import checked, own_fields, value_at

N_C, D_C = "search.n_c", "search.d_c_m"
H_S, H_C = "search.scan_altitude_agl_m", "search.check_altitude_agl_m"
SCAN_SPEED, CHECK_SPEED, SIDELAP = "search.scan_speed_mps", "search.check_speed_mps", "search.sidelap"
TUNED = (N_C, D_C, H_S, H_C, SCAN_SPEED, CHECK_SPEED, SIDELAP)

EASILY_SEEN_PX = 20.0  # a lower scan, with more pixels, takes longer and finds nothing more
_N_C_VALUES = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, math.inf)
_D_C_SHARES = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8)  # of the side of a square as large as the area
_STEPS = (0.01, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_MOST_VALUES = 24
_MOST_IN_RANGE = 1000
_MAX_SIDELAP = 0.5


@dataclass(frozen=True, slots=True)
class Parameter:
    """A dotted field of the scenario and its possible values, ascending."""

    field: str
    values: tuple[float, ...]


def default_space(scenarios: Sequence[Scenario]) -> list[Parameter]:
    """The default parameters, with values that suit all of ``scenarios``."""
    spaces = [_values_for(scenario) for scenario in scenarios]
    return [Parameter(field, _common([space[field] for space in spaces])) for field in TUNED]


def changed_space(
    space: Sequence[Parameter], scenarios: Sequence[Scenario], ranges: Sequence[str], fixed: Sequence[str]
) -> tuple[list[Parameter], dict[str, float]]:
    """``space`` after ``--range FIELD=LOW:HIGH`` (``FIELD=1,2,inf``) and ``--fix FIELD`` (``FIELD=VALUE``).

    Returns the parameters left to tune, and the values that ``--fix`` sets. Raises UserError for an unknown
    field, an empty range, values that make no valid scenario, or nothing left to tune.
    """
    left = {parameter.field: parameter for parameter in space}
    settings: dict[str, float] = {}
    ranged = set()
    for text in ranges:
        field, _, wanted = text.partition("=")
        field = known_field(field.strip(), scenarios, f"--range {text}")
        left[field] = Parameter(field, _parsed_range(text, field, wanted.strip(), scenarios))
        ranged.add(field)
    for text in fixed:
        field, equals, setting = text.partition("=")
        field = known_field(field.strip(), scenarios, f"--fix {text}")
        if field in ranged:
            raise UserError(f"--fix {text}: --range gives {field} a range; leave out one of the two")
        left.pop(field, None)
        if equals:
            settings[field] = _number(setting, f"--fix {text}")
    if not left:
        raise UserError("--fix: nothing is left to tune; fix fewer fields")
    _check_altitudes(left, scenarios, settings)
    for scenario in scenarios:
        for field in left:
            if value_at(scenario, field) is None:
                raise UserError(f"--range {field}: {scenario.name} has no value of it; give one with --set")
    for scenario in scenarios:
        fixed_scenario = change_scenario(scenario, settings)
        for parameter in left.values():
            if parameter.field not in (H_S, H_C):
                values = parameter.values
                for value in values if _is_whole(parameter.field, scenarios) else (values[0], values[-1]):
                    checked(change_scenario(fixed_scenario, {parameter.field: value}))
    return list(left.values()), settings


def known_field(field: str, scenarios: Sequence[Scenario], source: str) -> str:
    """``field``. Raises UserError, with the nearest name, unless it is a number of all scenarios."""
    fields = _kinds(scenarios)
    if field in fields:
        return field
    by_last = {name.rsplit(".", 1)[-1]: name for name in fields}
    near = difflib.get_close_matches(field, fields, n=1) or [
        by_last[name]
        for name in difflib.get_close_matches(field.rsplit(".", 1)[-1], by_last, n=1, cutoff=0.5)
    ]
    start = f"did you mean '{near[0]}'? " if near else ""
    raise UserError(
        f"{source}: there is no parameter '{field}'; {start}"
        f"write a number of the scenario, such as {', '.join(TUNED[:3])}"
    )


def _kinds(scenarios: Sequence[Scenario]) -> dict[str, set[Any]]:
    """The numbers that all scenarios have: by field, int, float or both."""
    own = [dict(own_fields(scenario.search.strategy)) for scenario in scenarios]
    common = [(name, info) for name, info in own[0].items() if all(name in others for others in own)]
    kinds = {
        name: {int, float} & {*union_arms(info.annotation)}
        for name, info in (*leaf_fields(Scenario), *common)
    }
    return {name: kind for name, kind in kinds.items() if kind}


def _is_whole(field: str, scenarios: Sequence[Scenario]) -> bool:
    return field == N_C or float not in _kinds(scenarios)[field]


def nearby_distances_m(scenario: Scenario) -> tuple[float, ...]:
    """A few d_c that may matter: parts of the area's size, the scenario's own, and infinity."""
    side = math.sqrt(scenario.area_enu_m.area)
    shares = {_round_distance(share * side) for share in (0.1, 0.2, 0.4)}
    return tuple(sorted(shares | {scenario.search.d_c_m, math.inf}))


def _values_for(scenario: Scenario) -> dict[str, tuple[float, ...]]:
    search, cruise = scenario.search, scenario.vehicle.cruise_speed_mps
    px_at_1_m = scenario.pixels_on_target(1.0)
    side = math.sqrt(scenario.area_enu_m.area)
    highest_m = min(px_at_1_m / UNSEEN_BELOW_PX, scenario.safety.altitude_max_agl_m)
    values: dict[str, Sequence[float]] = {
        N_C: _N_C_VALUES,
        D_C: [*(_round_distance(share * side) for share in _D_C_SHARES), math.inf],
        H_S: _grid(min(px_at_1_m / EASILY_SEEN_PX, search.scan_altitude_agl_m), highest_m),
        SCAN_SPEED: _grid(0.4 * cruise, cruise),
        CHECK_SPEED: _grid(0.1 * cruise, cruise),
        SIDELAP: _grid(0.0, _MAX_SIDELAP),
    }
    values[H_S] = _sound(scenario, H_S, values[H_S])
    lowest_scan_m = min([*values[H_S], search.scan_altitude_agl_m])
    highest_check_m = min(px_at_1_m / WISHED_AT_CHECK_PX, 0.8 * lowest_scan_m)
    values[H_C] = _sound(scenario, H_C, _grid(1.0, highest_check_m))
    return {field: tuple(sorted({*values[field], value_at(scenario, field)})) for field in TUNED}


def _sound(scenario: Scenario, field: str, values: Sequence[float]) -> list[float]:
    """The altitudes of a scan or a check that are possible and sound."""
    if field == H_S:
        possible = [v for v in values if v > scenario.search.check_altitude_agl_m]
    else:
        floor = scenario.safety.descent_floor_agl_m
        possible = [v for v in values if floor <= v < scenario.search.scan_altitude_agl_m]
    return [value for value in possible if _is_sound(field, change_scenario(scenario, {field: value}))]


def _is_sound(field: str, scenario: Scenario) -> bool:
    """Whether there is no warning of the field, and the sensor was calibrated for the search."""
    return not (
        any(warning.startswith(field) for warning in warnings_for(scenario))
        or model_for(scenario).beyond_calibration(scenario)
    )


def _common(spaces: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
    """Values inside the bounds of all spaces, or all values where these do not overlap."""
    low, high = max(s[0] for s in spaces), min(s[-1] for s in spaces)
    inside = {v for s in spaces for v in s if low <= v <= high}
    return tuple(sorted(inside)) if len(inside) > 1 else tuple(sorted(set().union(*spaces)))


def _grid(low: float, high: float) -> list[float]:
    """Round values from ``low`` to ``high``, at most ``_MOST_VALUES`` of them."""
    step = next((s for s in _STEPS if (high - low) / s < _MOST_VALUES), _STEPS[-1])
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(k * step, 6) for k in range(first, last + 1)]


def _round_distance(metres: float) -> float:
    return max(5.0, 5.0 * round(metres / 5.0))


def _parsed_range(text: str, field: str, wanted: str, scenarios: Sequence[Scenario]) -> tuple[float, ...]:
    source, is_whole = f"--range {text}", _is_whole(field, scenarios)
    values: set[float] = set()
    for part in wanted.split(",") if wanted else []:
        low_text, colon, high_text = part.partition(":")
        low = _number(low_text, source)
        high = _number(high_text, source) if colon else low
        if colon and (math.isinf(low) or math.isinf(high)):
            raise UserError(
                f"{source}: a range must end at a number; write inf on its own, such as {field}=1:8,inf"
            )
        if low > high:
            raise UserError(f"{source}: the range is empty; write LOW:HIGH with LOW below HIGH")
        if high - low > _MOST_IN_RANGE * (1.0 if field == N_C else _STEPS[-1]):
            raise UserError(
                f"{source}: the range holds more than {_MOST_IN_RANGE:,} values; "
                f"write a narrower one, or the values themselves, such as {field}=1,2,5"
            )
        if colon and field == N_C:
            values |= {float(n) for n in np.arange(math.ceil(low), math.floor(high) + 1)}
        else:
            between = _grid(low, high) if high > low else []
            values |= {low, high, *(value for value in between if not is_whole or value.is_integer())}
    if len(values) < 2:
        raise UserError(
            f"{source}: the range is empty; write two values or more, such as {field}=1:8 or {field}=1,2,inf "
            f"(one value: --fix {field}=VALUE)"
        )
    return tuple(sorted(values))


def _number(text: str, source: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise UserError(f"{source}: '{text.strip()}' is not a number; write a number or inf")
    return value


def _check_altitudes(
    space: Mapping[str, Parameter], scenarios: Sequence[Scenario], settings: Mapping[str, float]
) -> None:
    for scenario in scenarios:
        scans, checks = (
            space[field].values if field in space else (settings.get(field, value_at(scenario, field)),)
            for field in (H_S, H_C)
        )
        if checks[-1] >= scans[0]:
            raise UserError(
                f"--range {H_C}: reaches {checks[-1]:g} m, not below the lowest scan altitude "
                f"({scans[0]:g} m); write ranges that do not meet, or --fix one of them"
            )
        for scan_m, check_m in ((scans[0], checks[0]), (scans[-1], checks[0]), (scans[0], checks[-1])):
            changed = change_scenario(scenario, {H_S: scan_m, H_C: check_m})
            if beyond := model_for(changed).beyond_calibration(changed):
                raise UserError(f"{H_S} {scan_m:g} with {H_C} {check_m:g}: {beyond.rstrip('.')}")
