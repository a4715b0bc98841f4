"""Apparent temperatures of surfaces by material, orientation, sun and weather.

The energy balance of a surface over a periodic day, linear about the temperature of the air (Watson, 1975;
Price, 1977): sunshine, air, sky and, in what lives, the body heat it; it loses to the air by convection
(McAdams, 1954) and radiation, and into the slab below it, whose admittance for each harmonic is that of
Carslaw and Jaeger (1959). The response to each past hour follows from it, so that rocks and walls are warm
after sunset while grass and leaves follow the air. docs/thermal.md says what this leaves out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64
from skysweep.scenarios.model import Light
from skysweep.worlds.materials import THERMAL, Material, Thermal
from skysweep.worlds.weather import KELVIN, STEFAN_BOLTZMANN, STEP_H, STEPS, PastDay, past_day

EXTINCTION_PER_M = 2.5e-4  # of clear air in the long-wave infrared: 8 % of the contrast are lost over 300 m
_PAST_H = 1.0, 3.0, 6.0, 12.0, 24.0  # ends of the stretches into which the sunshine of a day is put together
_LOW_WIND = 0.5  # near the ground, times the mean wind
_GROUND_ALBEDO = 0.2
_SPREAD_K, _SPREAD_SHARE = 0.8, 0.2  # variation within a surface: always, and times its excess over the air


@dataclass(frozen=True, slots=True)
class Heat:
    """Temperatures in degrees C of every material at one moment.

    A row of ``table`` (M, 8): without direct sun, facing down; what the share of sky in view adds to that;
    what the direct sun of the past hour adds in its light; how much the temperature varies within a surface;
    what the direct sun of the four stretches before adds. Suns count with the cosine of their incidence.
    """

    table: F32
    sun_enu: F64  # (3,) now
    past_suns_enu: F64  # (4, 3)
    air_c: float
    sky_c: float

    def parts(self, materials: NDArray[np.integer], normals: F32) -> F32:
        """(N, 3) temperature without the sun of the past hour, what that adds in its light, and variation."""
        rows = self.table[materials]
        sky = 0.5 + 0.5 * normals[:, 2]
        past = np.maximum(normals @ self.past_suns_enu.T.astype(np.float32), 0.0)
        base = rows[:, 0] + rows[:, 1] * sky + (rows[:, 4:] * past).sum(axis=1)
        recent = rows[:, 2] * np.maximum(normals @ self.sun_enu.astype(np.float32), 0.0)
        return np.column_stack([base, recent, rows[:, 3]]).astype(np.float32)


def heat_of(light: Light, wind_mps: float, latitude_deg: float) -> Heat:
    """The temperatures at the moment of ``light``."""
    day = past_day(light, latitude_deg)
    ends = np.rint(np.array(_PAST_H) / STEP_H).astype(int)
    starts = np.concatenate([[0], ends[:-1]])
    if day.direct_w_m2[0] == 0.0:  # the sun is down: nothing is in its light
        starts[1], ends[0] = 0, 0
    stretches = [slice(a, b) for a, b in zip(starts, ends, strict=True)]
    suns = np.array([_mean_sun(day, stretch) for stretch in stretches])
    suns[0] = day.sun_enu[0]
    table = np.array([_row(m, day, wind_mps, stretches, suns) for m in Material])
    return Heat(table.astype(np.float32), suns[0], suns[1:], light.air_temperature_c, day.sky_c)


def _mean_sun(day: PastDay, stretch: slice) -> F64:
    """Where the sun stood (3,), weighted by its strength; upwards where it did not shine."""
    total = day.direct_w_m2[stretch] @ day.sun_enu[stretch]
    length = float(np.linalg.norm(total))
    return total / length if length > 1.0 else np.array([0.0, 0.0, 1.0])


def _row(material: Material, day: PastDay, wind_mps: float, stretches: list[slice], suns: F64) -> list[float]:
    of, air_c = THERMAL[material], float(day.air_c[0])
    air_k = air_c + KELVIN
    convection = of.exchange * (5.7 + 3.8 * _LOW_WIND * wind_mps)
    radiation = 4.0 * of.emissivity * STEFAN_BOLTZMANN * air_k**3
    loss = convection + radiation + of.inner_w_m2k
    response = _response(of, loss)
    absorbed = of.absorptance * (1.0 - of.evaporates)
    air = response @ (day.air_c - air_c) * (convection + radiation)
    inner = of.inner_w_m2k * (of.inner_c - air_c) / loss
    below = absorbed * _GROUND_ALBEDO * (response @ day.global_w_m2)
    above = absorbed * (response @ day.diffuse_w_m2)
    cold_k = day.sky_c + KELVIN
    to_sky = of.emissivity * STEFAN_BOLTZMANN * (air_k**4 - cold_k**4) / loss
    beams = []
    for stretch, sun in zip(stretches, suns, strict=True):
        level = np.maximum(day.sun_enu[stretch, 2], 0.0)
        on_level = response[stretch] @ (day.direct_w_m2[stretch] * level)
        beams.append(absorbed * on_level / max(sun[2], 0.05))
    shade = air_c + air + inner + below
    level_c = shade - below + above - to_sky + float(np.maximum(suns[:, 2], 0.0) @ beams)
    if material is Material.SNOW and level_c > 0.0:  # it melts
        return [0.0, 0.0, 0.0, _SPREAD_K, 0.0, 0.0, 0.0, 0.0]
    e, mirrored = of.emissivity, 1.0 - of.emissivity
    spread = e * (_SPREAD_K + _SPREAD_SHARE * abs(level_c - air_c))
    sky = e * (above - below - to_sky) + mirrored * (day.sky_c - air_c)
    return [e * shade + mirrored * air_c, sky, e * beams[0], spread, *(e * b for b in beams[1:])]


def _response(of: Thermal, loss_w_m2k: float) -> F64:
    """Temperature now (STEPS,) by 1 W/m2 in each step of the past day, as that repeats itself."""
    frequency = 2 * np.pi * np.fft.rfftfreq(STEPS, STEP_H * 3600.0)
    root = np.sqrt(1j * frequency)
    capacity = of.capacity * 1e6
    admittance = root * np.sqrt(of.conductivity * capacity)
    if math.isfinite(of.thickness_m):  # nothing passes through the far side
        admittance = admittance * np.tanh(root * of.thickness_m * np.sqrt(capacity / of.conductivity))
    return np.asarray(np.fft.irfft(1.0 / (loss_w_m2k + admittance), STEPS))
