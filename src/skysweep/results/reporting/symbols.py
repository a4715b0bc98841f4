"""Fields of a scenario and their values for a reader, with the paper's symbols, units and infinity."""

from __future__ import annotations

import math

_SYMBOLS = {
    "search.n_c": ("n_c", ""),
    "search.d_c_m": ("d_c", "m"),
    "search.c_t": ("c_t", ""),
    "search.scan_altitude_agl_m": ("h_S", "m"),
    "search.check_altitude_agl_m": ("h_C", "m"),
    "search.scan_speed_mps": ("v_S", "m/s"),
    "search.check_speed_mps": ("v_C", "m/s"),
}
_UNITS = {"m": "m", "mps": "m/s", "s": "s", "px": "px", "rad": "rad", "deg": "°", "hz": "Hz", "wh": "Wh"}


def number(value: float) -> str:
    """A number, with a sign for infinity."""
    return "∞" if math.isinf(value) else f"{value:g}"


def field_name(field: str) -> str:
    """A field of the scenario: the paper's symbol, or its words without the unit."""
    if field in _SYMBOLS:
        return _SYMBOLS[field][0]
    words = field.removeprefix("search.").replace(".", "_").split("_")
    return " ".join(words[:-1] if words[-1] in _UNITS and len(words) > 1 else words)


def field_unit(field: str) -> str:
    """The unit that a field's name ends with, or nothing."""
    return _SYMBOLS[field][1] if field in _SYMBOLS else _UNITS.get(field.rpartition("_")[2], "")


def field_title(field: str) -> str:
    """Name and unit, such as ``h_S (m)``."""
    unit = field_unit(field)
    return f"{field_name(field)} ({unit})" if unit else field_name(field)


def value_text(field: str, value: bool | float | str) -> str:
    """A field's value with its unit."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value).lower() if isinstance(value, bool) else str(value)
    return number(value) if math.isinf(value) else f"{value:g} {field_unit(field)}".rstrip()
