"""The map of a search in pixels: the belief, the candidates and the vehicles."""

from __future__ import annotations

import cv2
import numpy as np

from skysweep.arrays import U8
from skysweep.gym.spaces import CONFIRMED, EMPTY, OPEN, REJECTED, UNCHECKED
from skysweep.gym.team import Team

_LONGEST_PX = 512
_UNSEEN, _SEEN, _BEYOND = np.array([38, 50, 64]), np.array([214, 226, 205]), np.array([120, 120, 120])
_VEHICLE = (11, 95, 165)
_STATUS = {OPEN: (240, 180, 0), CONFIRMED: (200, 30, 30)}
_STATUS |= {REJECTED: (110, 110, 110), UNCHECKED: (150, 60, 190)}


def draw(team: Team) -> U8:
    """RGB (H, W, 3), north up: dark is unseen, grey is outside, small circles are candidates by status."""
    unseen = team.sorties[0].belief.unseen[..., None]
    raster = np.where(unseen > 0.0, _SEEN + (_UNSEEN - _SEEN) * unseen, _BEYOND)
    half_x, half_y = team.chart.half_m
    scale = _LONGEST_PX / (2.0 * max(half_x, half_y))
    width, height = max(1, round(2.0 * half_x * scale)), max(1, round(2.0 * half_y * scale))
    north_up = np.ascontiguousarray(raster[::-1], dtype=np.uint8)
    picture = cv2.resize(north_up, (width, height), interpolation=cv2.INTER_NEAREST)

    def pixel(east: float, north: float) -> tuple[int, int]:
        return round((east + 1.0) / 2.0 * width), round((1.0 - north) / 2.0 * height)

    for sortie in team.sorties:
        told = sortie.observe(team.rules.slots, team.rules.time_limit_s)
        for row, status in zip(told["candidates"], told["candidate_status"].tolist(), strict=True):
            if status != EMPTY:
                cv2.circle(picture, pixel(*row[:2].tolist()), 4, _STATUS[status], -1, cv2.LINE_AA)
        at = pixel(*told["vehicle"][:2].tolist())
        cv2.circle(picture, at, 7, _VEHICLE, 2 if sortie.is_over else -1, cv2.LINE_AA)
    return np.asarray(picture, dtype=np.uint8)
