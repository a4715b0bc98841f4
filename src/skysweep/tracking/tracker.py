"""Candidates from detections: georeference, gate by covariance, merge.

The measurement model is that of steady flight: an angular error of the camera (attitude, mounting, delay)
that grows with slant range, and a position error of the vehicle. Sightings in hard manoeuvres are worse than
it says, land outside the gate and open a second candidate. That is what the paper saw ("false estimations of
the targets' locations whenever the vehicle changes flight direction") and what a CHECK is there to sort out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from scipy.optimize import linear_sum_assignment

from skysweep.arrays import F64, I64
from skysweep.tracking.georeference import GroundHeight, pixels_to_ground
from skysweep.types import Candidate, Detections, Sighting

_FAR = 1e6  # cost of what is no match
WANDERS_M = 12.0  # farther away nothing is taken for an old candidate, however long ago it was seen
_EDGE_PX = 1.0  # a box this near to an edge of the picture is cut by it


@dataclass(frozen=True, slots=True)
class TrackerModel:
    """Standard deviations of the measurement and the gate."""

    angle_std_rad: float = math.radians(1.5)
    position_std_m: float = 0.5
    common_std_m: float = 0.4  # error shared by all sightings: averaging does not remove it
    gate_probability: float = 0.99
    smallest_share: float = 0.15  # of a target's size that a box may span: most of it may be hidden ...
    largest_share: float = 5.0  # ... and a shadow may make it longer


class GroundTracker:
    """Keeps one candidate per thing seen on the ground. Implements ``types.Tracker``.

    ``sizes_m`` tells the smallest and largest size of what is searched for, by class. A box that spans far
    less or more on the ground is something else, and left out; classes without a size are all taken. Where
    they are expected to move, a candidate may have gone anywhere at ``speed_mps`` since it was last seen, up
    to WANDERS_M.
    """

    def __init__(
        self,
        ground_height_m: GroundHeight,
        sizes_m: Mapping[str, tuple[float, float]] | None = None,
        model: TrackerModel | None = None,
        speed_mps: float = 0.0,
    ) -> None:
        self._speed_mps = speed_mps
        self._ground_height_m = ground_height_m
        self._model = model or TrackerModel()
        self._extents_m = {
            name: (self._model.smallest_share * low, self._model.largest_share * high)
            for name, (low, high) in (sizes_m or {}).items()
        }
        self._gate = -2.0 * math.log1p(-self._model.gate_probability)  # of chi-square, 2 degrees of freedom
        self._candidates: dict[int, Candidate] = {}
        # The same for the compiled functions: candidate k in row k - 1, classes numbered as they turn up.
        self._positions_enu_m = np.empty((0, 3))
        self._covariances_m2 = np.empty((0, 2, 2))
        self._classes = np.empty(0, dtype=np.int64)
        self._class_numbers: dict[str, int] = {}

    def candidates(self) -> dict[int, Candidate]:
        """All candidates by id (a copy)."""
        return dict(self._candidates)

    def snapshot(self) -> dict[str, Any]:
        """All candidates as plain data."""
        return {
            "candidates": [
                {
                    "class_name": c.class_name,
                    "p": c.position_enu_m.tolist(),
                    "covariance_m2": c.covariance_m2.tolist(),
                    "first_seen_s": c.first_seen_s,
                    "last_seen_s": c.last_seen_s,
                    "confidences": list(c.confidences),
                }
                for c in self._candidates.values()
            ]
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue from a snapshot."""
        told = snapshot["candidates"]
        self._positions_enu_m = np.array([c["p"] for c in told]).reshape(-1, 3)
        self._covariances_m2 = np.array([c["covariance_m2"] for c in told]).reshape(-1, 2, 2)
        self._classes = np.array([self._class_number(c["class_name"]) for c in told], dtype=np.int64)
        self._candidates = {
            k + 1: Candidate(
                k + 1,
                c["class_name"],
                self._positions_enu_m[k].copy(),
                self._covariances_m2[k].copy(),
                c["first_seen_s"],
                c["last_seen_s"],
                tuple(c["confidences"]),
            )
            for k, c in enumerate(told)
        }

    def update(self, detections: Detections) -> tuple[Sighting, ...]:
        """Assign one frame's detections; each candidate takes at most one of them."""
        if not len(detections):
            return ()
        boxes = detections.boxes_xyxy_px
        centres = (boxes[:, :2] + boxes[:, 2:]) / 2
        points = pixels_to_ground(detections.lens, detections.camera, centres, self._ground_height_m)
        extents_m = np.array([self._extents_m.get(name, (0.0, math.inf)) for name in detections.class_names])
        covariances = np.empty((len(points), 2, 2))
        _measure(
            points,
            covariances,
            boxes,
            extents_m,
            *detections.camera,
            detections.lens.focal_px,
            self._model.angle_std_rad,
            self._model.position_std_m,
        )
        assigned = self._assign(detections.time_s, detections.class_names, points, covariances)
        return tuple(
            self._absorb(detections, i, points[i], covariances[i], assigned.get(i))
            for i, x in enumerate(points[:, 0].tolist())
            if math.isfinite(x)
        )

    def _assign(
        self, time_s: float, class_names: tuple[str, ...], points: F64, covariances: F64
    ) -> dict[int, int]:
        """Detection index -> candidate id: the cheapest one-to-one assignment inside the gates."""
        if not self._candidates:
            return {}
        cost = np.empty((len(points), len(self._candidates)))
        wander_m = np.zeros(len(self._candidates))
        if self._speed_mps:
            wander_m[:] = [self._wander_m(time_s, c) for c in self._candidates.values()]
        _write_gated_distances(
            cost,
            points,
            covariances,
            np.array([self._class_number(name) for name in class_names]),
            self._positions_enu_m,
            self._covariances_m2 + (wander_m**2)[:, None, None] * np.eye(2),
            wander_m,
            self._classes,
            self._gate,
        )
        rows, columns = linear_sum_assignment(cost)
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        return {r: c + 1 for r, c in pairs if cost[r, c] < _FAR}

    def _absorb(
        self, detections: Detections, i: int, point: F64, covariance: F64, candidate_id: int | None
    ) -> Sighting:
        confidence = float(detections.confidences[i])
        common_m2 = self._model.common_std_m**2
        if candidate_id is None:
            candidate_id = len(self._candidates) + 1
            is_new = True
            position, posterior = point, covariance + common_m2 * np.eye(2)
            class_name, first_seen_s = detections.class_names[i], detections.time_s
            confidences: tuple[float, ...] = (confidence,)
            self._positions_enu_m = np.append(self._positions_enu_m, position[None], axis=0)
            self._covariances_m2 = np.append(self._covariances_m2, posterior[None], axis=0)
            self._classes = np.append(self._classes, self._class_number(class_name))
        else:
            old = self._candidates[candidate_id]
            is_new = False
            position, posterior = np.empty(3), np.empty((2, 2))
            spread = old.covariance_m2
            if self._speed_mps:
                spread = spread + self._wander_m(detections.time_s, old) ** 2 * np.eye(2)
            _merge(position, posterior, old.position_enu_m, spread, point, covariance, common_m2)
            position[2] = self._ground_height_m(position[None, :2])[0]
            class_name, first_seen_s = old.class_name, old.first_seen_s
            confidences = (*old.confidences, confidence)
            self._positions_enu_m[candidate_id - 1] = position
            self._covariances_m2[candidate_id - 1] = posterior
        self._candidates[candidate_id] = Candidate(
            candidate_id, class_name, position, posterior, first_seen_s, detections.time_s, confidences
        )
        altitude = float(detections.camera.position_enu_m[2] - point[2])
        box = left, top, right, bottom = detections.boxes_xyxy_px[i].tolist()
        lens = detections.lens
        is_cut = min(left, top, lens.width_px - right, lens.height_px - bottom) < _EDGE_PX
        return Sighting(candidate_id, is_new, detections.time_s, point, confidence, altitude, box, is_cut)

    def _wander_m(self, time_s: float, candidate: Candidate) -> float:
        """Standard deviation along each axis of how far a candidate has gone since it was last seen."""
        return min(self._speed_mps * (time_s - candidate.last_seen_s), WANDERS_M) / math.sqrt(2.0)

    def _class_number(self, name: str) -> int:
        return self._class_numbers.setdefault(name, len(self._class_numbers))


@njit(cache=True)
def _measure(
    points: F64,
    covariances: F64,
    boxes: F64,
    extents_m: F64,
    eye: F64,
    R: F64,
    focal_px: float,
    angle_std: float,
    position_std: float,
) -> None:
    """Write the ``covariances`` (N, 2, 2) of ``points`` (N, 3).

    That is the angular error spread over the ground, stretched where the ray is oblique. Points whose boxes
    span less or more on the ground than ``extents_m`` (N, 2) allow become NaN.
    """
    for k in range(len(points)):
        x, y, z = points[k, 0] - eye[0], points[k, 1] - eye[1], points[k, 2] - eye[2]
        depth = x * R[0, 2] + y * R[1, 2] + z * R[2, 2]
        across_px = max(boxes[k, 2] - boxes[k, 0], boxes[k, 3] - boxes[k, 1])
        if not extents_m[k, 0] <= across_px * depth / focal_px <= extents_m[k, 1]:
            points[k] = np.nan
        distance = math.sqrt(x * x + y * y + z * z)
        sine = max(abs(z) / distance, 0.1)
        across = (angle_std * distance) ** 2
        horizontal = math.hypot(x, y)
        if horizontal > 1e-6:
            x, y = x / horizontal, y / horizontal
        else:
            x, y = 1.0, 0.0
        stretch = across * (1.0 / sine**2 - 1.0)
        steady = across + position_std**2
        covariances[k, 0, 0], covariances[k, 1, 1] = steady + stretch * x * x, steady + stretch * y * y
        covariances[k, 0, 1] = covariances[k, 1, 0] = stretch * x * y


@njit(cache=True)
def _write_gated_distances(
    cost: F64,
    points: F64,
    covariances: F64,
    kinds: I64,
    positions: F64,
    spreads: F64,
    wander_m: F64,
    known_kinds: I64,
    gate: float,
) -> None:
    """Squared Mahalanobis distances (N, M) of sightings to candidates of their kind.

    ``_FAR`` outside the gate, for other kinds, and for sightings that are not on the ground (NaN).
    """
    for r in range(len(points)):
        reach = 4.0 * math.sqrt(covariances[r, 0, 0] + covariances[r, 1, 1]) + 10.0
        for c in range(len(positions)):
            cost[r, c] = _FAR
            x, y = positions[c, 0] - points[r, 0], positions[c, 1] - points[r, 1]
            far = reach + 4.0 * wander_m[c]
            if kinds[r] != known_kinds[c] or not (abs(x) < far and abs(y) < far):
                continue
            xx = spreads[c, 0, 0] + covariances[r, 0, 0]
            xy = spreads[c, 0, 1] + covariances[r, 0, 1]
            yy = spreads[c, 1, 1] + covariances[r, 1, 1]
            squared = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
            if squared <= gate:
                cost[r, c] = squared


@njit(cache=True)
def _merge(
    position: F64, posterior: F64, old: F64, spread: F64, point: F64, covariance: F64, common_m2: float
) -> None:
    """Kalman update of a candidate by a sighting: ``position`` (3,) but its height, ``posterior`` (2, 2).

    The error that all sightings share is left out of what they average, and put back after.
    """
    axx, axy, ayy = spread[0, 0] - common_m2, spread[0, 1], spread[1, 1] - common_m2
    sxx, sxy, syy = axx + covariance[0, 0], axy + covariance[0, 1], ayy + covariance[1, 1]
    determinant = sxx * syy - sxy * sxy
    gxx, gxy = (axx * syy - axy * sxy) / determinant, (axy * sxx - axx * sxy) / determinant
    gyx, gyy = (axy * syy - ayy * sxy) / determinant, (ayy * sxx - axy * sxy) / determinant
    x, y = point[0] - old[0], point[1] - old[1]
    position[0], position[1] = old[0] + gxx * x + gxy * y, old[1] + gyx * x + gyy * y
    posterior[0, 0] = (1.0 - gxx) * axx - gxy * axy + common_m2
    posterior[1, 1] = (1.0 - gyy) * ayy - gyx * axy + common_m2
    posterior[0, 1] = posterior[1, 0] = ((1.0 - gxx) * axy - gxy * ayy + (1.0 - gyy) * axy - gyx * axx) / 2.0
