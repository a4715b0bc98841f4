"""The day behind a moment: where the sun was, how strongly it shone, how warm the air was.

The sun's elevation and heading and the latitude give its declination and the solar time, and so its path over
the past 24 hours, by day and by night.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F64
from skysweep.scenarios.model import Light

STEPS = 288  # of a day
STEP_H = 24.0 / STEPS
STEFAN_BOLTZMANN = 5.670e-8  # W/(m2 K4)
KELVIN = 273.15
_WARMEST_H = 15.0  # solar time of the warmest air
_AIR_K_PER_W_M2 = 0.02  # amplitude of the air's temperature, by the day's mean sunshine
_SOLAR_W_M2 = 1353.0


@dataclass(frozen=True, slots=True)
class PastDay:
    """The 24 hours before a moment: index k is k times STEP_H earlier."""

    sun_enu: F64  # (STEPS, 3) unit, towards the sun
    direct_w_m2: F64  # (STEPS,) on a surface facing the sun
    diffuse_w_m2: F64  # (STEPS,) on level ground
    air_c: F64  # (STEPS,)
    sky_c: float  # at the moment: temperature of a black sky that radiates as much

    @property
    def global_w_m2(self) -> F64:
        """(STEPS,) on level ground."""
        return np.asarray(self.direct_w_m2 * np.maximum(self.sun_enu[:, 2], 0.0) + self.diffuse_w_m2)


def past_day(light: Light, latitude_deg: float) -> PastDay:
    """The day before the moment of ``light``.

    Sources: Kasten (1965) for air mass, Meinel and Meinel (1976) for the direct beam, Kasten and Czeplak
    (1980) for clouds, Swinbank (1963) for the clear sky.
    """
    sun, solar_h = _sun_path(light, np.radians(np.clip(latitude_deg, -89.9, 89.9)))
    height = np.maximum(sun[:, 2], 0.0)
    clear = np.where(height > 0.0, _SOLAR_W_M2 * 0.7 ** (_air_mass(height) ** 0.678), 0.0)
    cloud = light.cloud_cover
    direct = clear * (1.0 - cloud)
    level = clear * (height + 0.1) * (1.0 - 0.75 * cloud**3.4)
    diffuse = level - direct * height
    swing = _AIR_K_PER_W_M2 * float(level.mean())
    phase = np.cos(2 * np.pi * (solar_h - _WARMEST_H) / 24.0)
    air = light.air_temperature_c + swing * (phase - phase[0])
    air_k = light.air_temperature_c + KELVIN
    sky_k = (cloud * air_k**4 + (1.0 - cloud) * (0.0552 * air_k**1.5) ** 4) ** 0.25
    return PastDay(sun, direct, diffuse, air, sky_k - KELVIN)


def sine_of_declination(light: Light, latitude_rad: float) -> float:
    """Of the sun's declination, which tells the season."""
    elevation, heading = np.radians(light.sun_elevation_deg), np.radians(light.sun_heading_deg)
    towards_pole = np.cos(latitude_rad) * np.cos(elevation) * np.cos(heading)
    return float(np.sin(latitude_rad) * np.sin(elevation) + towards_pole)


def _sun_path(light: Light, latitude_rad: float) -> tuple[F64, F64]:
    """Directions (STEPS, 3) towards the sun, and solar times (STEPS,) in hours."""
    elevation, heading = np.radians(light.sun_elevation_deg), np.radians(light.sun_heading_deg)
    sin_lat, cos_lat = np.sin(latitude_rad), np.cos(latitude_rad)
    sin_dec = sine_of_declination(light, latitude_rad)
    cos_dec = np.sqrt(max(1.0 - sin_dec**2, 0.0))
    east = np.cos(elevation) * np.sin(heading)
    south = sin_lat * np.cos(elevation) * np.cos(heading) - cos_lat * np.sin(elevation)
    now = np.arctan2(-east, -south)  # hour angle, 0 at noon
    angle = now - 2 * np.pi * np.arange(STEPS) / STEPS
    sun = np.column_stack(
        [
            -cos_dec * np.sin(angle),
            cos_lat * sin_dec - sin_lat * cos_dec * np.cos(angle),
            sin_lat * sin_dec + cos_lat * cos_dec * np.cos(angle),
        ]
    )
    return sun, 12.0 + angle * 12.0 / np.pi


def _air_mass(sin_elevation: ArrayLike) -> F64:
    sine = np.asarray(sin_elevation, dtype=float)
    return np.asarray(1.0 / (sine + 0.15 * (np.degrees(np.arcsin(sine)) + 3.885) ** -1.253))
