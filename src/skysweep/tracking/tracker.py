"""Candidates from detections: georeference, gate by covariance, merge.

The measurement model is that of steady flight: an angular error of the camera (attitude, mounting, delay)
that grows with slant range, and a position error of the vehicle. Sightings in hard manoeuvres are worse than
it says, land outside the gate and open a second candidate. That is what the paper saw ("false estimations of
the targets' locations whenever the vehicle changes flight direction") and what a CHECK is there to sort out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

from skysweep.tracking.georeference import GroundHeight, pixels_to_ground
from skysweep.types import Candidate, Detections, Sighting

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrackerModel:
    """Standard deviations of the measurement and the gate."""

    angle_std_rad: float = np.radians(1.5)
    position_std_m: float = 0.5
    common_std_m: float = 0.4  # error shared by all sightings: averaging does not remove it
    gate_probability: float = 0.99


class GroundTracker:
    """Keeps one candidate per thing seen on the ground. Implements ``types.Tracker``."""

    def __init__(self, ground_height_m: GroundHeight, model: TrackerModel | None = None) -> None:
        self._ground_height_m = ground_height_m
        self._model = model or TrackerModel()
        self._gate = float(chi2.ppf(self._model.gate_probability, df=2))
        self._candidates: dict[int, Candidate] = {}

    def candidates(self) -> dict[int, Candidate]:
        """All candidates by id (a copy)."""
        return dict(self._candidates)

    def update(self, detections: Detections) -> tuple[Sighting, ...]:
        """Assign one frame's detections; each candidate takes at most one of them."""
        if not len(detections):
            return ()
        boxes = detections.boxes_xyxy_px
        centres = (boxes[:, :2] + boxes[:, 2:]) / 2
        points = pixels_to_ground(detections.lens, detections.camera, centres, self._ground_height_m)
        hit = np.isfinite(points[:, 0])
        indices = np.flatnonzero(hit)
        covariances = {int(i): self._measurement_covariance(detections, points[i]) for i in indices}
        assigned = self._assign(detections, points, covariances)
        return tuple(
            self._absorb(detections, int(i), points[i], covariances[int(i)], assigned.get(int(i)))
            for i in indices
        )

    def _measurement_covariance(self, detections: Detections, point: F64) -> F64:
        """(2, 2): the angular error spread over the ground, stretched where the ray is oblique."""
        ray = point - detections.camera.position_enu_m
        distance = float(np.linalg.norm(ray))
        sine = max(abs(ray[2]) / distance, 0.1)
        across = (self._model.angle_std_rad * distance) ** 2
        horizontal = float(np.hypot(ray[0], ray[1]))
        radial = ray[:2] / horizontal if horizontal > 1e-6 else np.array([1.0, 0.0])
        spread = across * (np.eye(2) + (1 / sine**2 - 1) * np.outer(radial, radial))
        return np.asarray(spread + self._model.position_std_m**2 * np.eye(2))

    def _assign(self, detections: Detections, points: F64, covariances: dict[int, F64]) -> dict[int, int]:
        """Detection index -> candidate id: the cheapest one-to-one assignment inside the gates."""
        ids = list(self._candidates)
        rows = list(covariances)
        if not ids or not rows:
            return {}
        far = 1e6
        cost = np.full((len(rows), len(ids)), far)
        positions = np.array([self._candidates[k].position_enu_m[:2] for k in ids])
        for r, i in enumerate(rows):
            gaps = positions - points[i, :2]
            reach = 4.0 * np.sqrt(covariances[i].trace()) + 10.0
            for c in np.flatnonzero((np.abs(gaps) < reach).all(axis=1)):
                candidate = self._candidates[ids[c]]
                if candidate.class_name != detections.class_names[i]:
                    continue
                total = candidate.covariance_m2 + covariances[i]
                squared = float(gaps[c] @ np.linalg.solve(total, gaps[c]))
                if squared <= self._gate:
                    cost[r, c] = squared
        pairs = zip(*linear_sum_assignment(cost), strict=True)
        return {rows[r]: ids[c] for r, c in pairs if cost[r, c] < far}

    def _absorb(
        self, detections: Detections, i: int, point: F64, covariance: F64, candidate_id: int | None
    ) -> Sighting:
        confidence = float(detections.confidences[i])
        common = self._model.common_std_m**2 * np.eye(2)
        if candidate_id is None:
            candidate_id = len(self._candidates) + 1
            self._candidates[candidate_id] = Candidate(
                candidate_id,
                detections.class_names[i],
                point,
                covariance + common,
                detections.time_s,
                detections.time_s,
                (confidence,),
            )
            is_new = True
        else:
            old = self._candidates[candidate_id]
            prior = old.covariance_m2 - common
            gain = prior @ np.linalg.inv(prior + covariance)
            xy = old.position_enu_m[:2] + gain @ (point[:2] - old.position_enu_m[:2])
            posterior = (np.eye(2) - gain) @ prior
            self._candidates[candidate_id] = replace(
                old,
                position_enu_m=np.array([xy[0], xy[1], self._ground_height_m(xy[None])[0]]),
                covariance_m2=(posterior + posterior.T) / 2 + common,
                last_seen_s=detections.time_s,
                confidences=(*old.confidences, confidence),
            )
            is_new = False
        altitude = float(detections.camera.position_enu_m[2] - point[2])
        return Sighting(candidate_id, is_new, detections.time_s, point, confidence, altitude)
