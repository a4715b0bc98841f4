"""A camera and a detector as one sensor."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

from skysweep.sensing.schedule import Exposures
from skysweep.types import Camera, Detections, Detector, Frame, VehicleState

_EPS_S = 1e-6


class ImagingSensor:
    """Captures at the detector's rate and hands results on ``latency_s`` after exposure.

    The detector works in a thread of its own while the next picture is rendered. Results are released by
    the vehicle's time alone, so that nothing depends on how fast the machine is. Implements ``types.Sensor``.
    ``last_look`` is the newest frame that was answered, with the answer.
    """

    def __init__(self, camera: Camera, detector: Detector, exposures: Exposures, latency_s: float) -> None:
        self._camera = camera
        self._detector = detector
        self._exposures = exposures
        self._latency_s = latency_s
        self._pending: deque[tuple[Frame, Future[Detections]]] = deque()
        self.last_look: tuple[Frame, Detections] | None = None
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="detector")

    def sense(self, state: VehicleState) -> Detections | None:
        """Take a picture if one is due; return the oldest result whose time has come."""
        exposed = self._exposures.due(state)
        if exposed is not None:
            frame = self._camera.capture(exposed)
            self._pending.append((frame, self._worker.submit(self._detector.detect, frame)))
        if self._pending and state.time_s >= self._pending[0][0].time_s + self._latency_s - _EPS_S:
            frame, answer = self._pending.popleft()
            self.last_look = frame, answer.result()
            return self.last_look[1]
        return None

    def close(self) -> None:
        """Stop the worker and let go of the camera."""
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._camera.close()
