"""What a plan does not show by itself: unseen ground, heights along the way, radio, light."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any

import numpy as np

from skysweep.planning.coverage import CoveragePlan
from skysweep.planning.flown_path import ANTENNA_M, FlownPath, flown_path, hidden_from, mast_enu_m
from skysweep.planning.proof import Proof, prove
from skysweep.planning.sun import LOW_DEG, Sun, sun_at
from skysweep.scenarios.model import Scenario
from skysweep.types import XY
from skysweep.worlds.world import build_terrain

_FLIES_HIGHER_M = 2.0  # than planned, at most, where the ground falls
_NAMED = 3  # places in a sentence
_LOWEST_SHARE = 0.8  # of the scan altitude, from which a low place is worth naming


@dataclass(frozen=True)
class Assessment:
    """A plan, judged over its terrain before take-off."""

    scenario: Scenario
    proof: Proof | None  # none where the camera does not look straight down
    path: FlownPath
    slowed_s: float  # by slopes
    hidden: list[tuple[XY, float]]  # middle and length of stretches without radio, the longest first
    hidden_share: float  # of the path
    sun: Sun
    is_night: bool

    def rows(self) -> list[tuple[str, str]]:
        """Names and values for people."""
        return [
            ("seen by the camera", self._seen()),
            ("height above ground", self._heights()),
            ("radio", self._radio()),
            ("sun", self._sun()),
        ]

    def warnings(self) -> Iterator[str]:
        """A sentence for each thing that should change before take-off."""
        if self.proof is not None and self._missed and self.scenario.search.plan is None:
            yield (
                f"safety.altitude_max_agl_m: {100 * (1.0 - self.proof.share):.2g} % of the area is in no "
                f"picture, {_named(self._missed, 'm2')}; raise the ceiling, or write a larger search.sidelap"
            )
        ceiling_m = self.scenario.safety.altitude_max_agl_m
        highest = int(self.path.agl_m.argmax())
        above_m = max(self.scenario.safety.fence_tolerance_m - _FLIES_HIGHER_M, 0.0)
        if self.path.agl_m[highest] > ceiling_m + above_m:
            x, y = self.path.xy_enu_m[highest].tolist()
            search = self.path.search
            if search.start <= highest < search.stop:
                field, cures = "search.scan_speed_mps", "lower, write another search.transect_heading_deg"
            else:
                field, cures = "vehicle.cruise_speed_mps", "lower, move home"
            yield (
                f"{field}: at [{x:.0f}, {y:.0f}] the ground falls faster than the vehicle sinks, and it is "
                f"{self.path.agl_m[highest]:.0f} m above it, higher than safety.altitude_max_agl_m "
                f"({ceiling_m:g}), which ends the search; fly slower or {cures}, or raise the ceiling"
            )
        if self.scenario.camera.kind == "thermal":
            return
        if self.is_night:
            yield "--at: the sun is below the horizon, and the camera sees nothing; fly by day"
        elif self.sun.elevation_deg < LOW_DEG:
            yield (
                f"light.sun_elevation_deg: the sun is only {self.sun.elevation_deg:.0f} degrees high, and "
                f"shadows are {self.sun.shadow_ratio:.1f} times as long as what throws them; "
                "fly nearer to noon if you can"
            )

    def record(self) -> dict[str, Any]:
        """The figures, for JSON; lengths in metres, shares 0..1, places east and north."""
        agl_m = self.path.agl_m[self.path.search]
        return {
            "seen_share": None if self.proof is None else self.proof.share,
            "unseen": [{"xy_enu_m": list(xy), "area_m2": area} for xy, area in self._missed],
            "height_agl_m": {
                "lowest": float(agl_m.min()),
                "median": float(np.median(agl_m)),
                "highest": float(agl_m.max()),
                "lowest_out_and_home": float(self.path.agl_m.min()),
            },
            "slowed_s": self.slowed_s,
            "radio_share": 1.0 - self.hidden_share,
            "radio_hidden": [{"xy_enu_m": list(xy), "length_m": length} for xy, length in self.hidden],
            "sun": {"elevation_deg": self.sun.elevation_deg, "heading_deg": self.sun.heading_deg},
        }

    @cached_property
    def _missed(self) -> list[tuple[XY, float]]:
        """Middle and area in m2 of each patch that is not seen, the largest first."""
        return [] if self.proof is None else [((p.x, p.y), area) for p, area in self.proof.unseen_places()]

    def _seen(self) -> str:
        if self.proof is None:
            return f"not known: camera.gimbal.pitch_deg is {self.scenario.camera.gimbal.pitch_deg:g}"
        cells = f"{len(self.proof.seen):,} cells of {self.proof.cells.size_m:.1f} m"
        if not self._missed:
            return f"all of the area: each of {cells}"
        return f"{self.proof.share:.2%} of {cells}; not {_named(self._missed, 'm2')}"

    def _heights(self) -> str:
        agl_m = self.path.agl_m[self.path.search]
        slower = f", {self.slowed_s / 60:.1f} min slower on slopes" if self.slowed_s >= 3.0 else ""
        lowest = int(self.path.agl_m.argmin())
        x, y = self.path.xy_enu_m[lowest].tolist()
        low = f"; lowest {self.path.agl_m[lowest]:.0f} m at [{x:.0f}, {y:.0f}]"
        worth = self.path.agl_m[lowest] < _LOWEST_SHARE * float(np.median(agl_m))
        return f"{agl_m.min():.0f} to {agl_m.max():.0f} m{slower}{low if worth else ''}"

    def _radio(self) -> str:
        mast = self.scenario.safety.radio_mast_enu_m
        where = f"an antenna {ANTENNA_M:g} m above home" if mast is None else "the mast"
        if not self.hidden:
            return f"in sight of {where} all the way"
        return (
            f"in sight of {where} for {1.0 - self.hidden_share:.0%} of the path; not for "
            f"{_named(self.hidden, 'm')}"
        )

    def _sun(self) -> str:
        if self.is_night:
            return f"{-self.sun.elevation_deg:.0f}\N{DEGREE SIGN} below the horizon"
        return (
            f"{self.sun.elevation_deg:.0f}\N{DEGREE SIGN} high at {self.sun.heading_deg:.0f}\N{DEGREE SIGN}; "
            f"a shadow is {self.sun.shadow_ratio:.1f} times as long as what throws it"
        )


def assess(plan: CoveragePlan, scenario: Scenario, when: datetime | None = None) -> Assessment:
    """Judge a plan for the scan altitude; the sun is the scenario's, or that of a moment with a time zone."""
    terrain = build_terrain(scenario)
    path = flown_path(plan, scenario, scenario.search.scan_altitude_agl_m, terrain)
    hidden = hidden_from(mast_enu_m(scenario, terrain), path, terrain)
    light, home = scenario.light, scenario.home
    sun = Sun(light.sun_elevation_deg, light.sun_heading_deg)
    if when is not None:
        sun = sun_at(when, home.latitude_deg, home.longitude_deg)
    return Assessment(
        scenario,
        prove(plan, scenario, terrain) if scenario.camera.gimbal.looks_down else None,
        path,
        float(plan.lost_s(scenario.search.scan_speed_mps).sum()),
        path.stretches(hidden),
        float(hidden.mean()),
        sun,
        sun.elevation_deg <= 0.0,
    )


def _named(places: list[tuple[XY, float]], unit: str) -> str:
    """The largest of some places with a size each, in words."""
    words = [f"{size:,.0f} {unit} at [{x:.0f}, {y:.0f}]" for (x, y), size in places[:_NAMED]]
    more = len(places) - _NAMED
    return ", ".join(words) + (f" and {more} more places" if more > 0 else "")
