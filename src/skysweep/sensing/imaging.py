"""A camera and a detector as one sensor."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TookTooLong
from dataclasses import dataclass
from queue import SimpleQueue
from threading import Thread
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.sensing.schedule import Exposures, Pace
from skysweep.types import Camera, Detections, Detector, Frame, VehicleState

_EPS_S = 1e-6
PATIENCE_S = 60.0  # of wall time, for an answer
_LITTLE_PATIENCE_S = 1.0  # with a detector that did not answer last time
_FAREWELL_S = 5.0


class DetectorError(Exception):
    """The detector failed on one picture; the next may be answered."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What the detector said to one picture, without the pose, which a mission knows."""

    boxes_xyxy_px: NDArray[np.float64]  # (N, 4)
    confidences: NDArray[np.float64]  # (N,)
    class_names: tuple[str, ...]  # (N,)
    failure: str | None = None  # instead of an answer

    def to(self, frame: Frame) -> Detections:
        """The detections of ``frame``. Raises DetectorError where there was no answer."""
        if self.failure is not None:
            raise DetectorError(self.failure)
        return Detections(
            frame.time_s, self.boxes_xyxy_px, self.confidences, self.class_names, frame.camera, frame.lens
        )


@runtime_checkable
class SkippingCamera(Camera, Protocol):
    """A camera that can leave out a picture and still take the next as if it had taken this one."""

    def skip(self, state: VehicleState) -> Frame:
        """The frame with an empty picture (0, 0, 3)."""
        ...


@runtime_checkable
class InterruptibleDetector(Detector, Protocol):
    """A detector that can be told to break off a look."""

    def interrupt(self) -> None:
        """Called from another thread; ``detect`` raises."""
        ...


class ImagingSensor:
    """Captures at the detector's rate and hands results on ``latency_s`` after exposure.

    The detector works in a thread of its own while the next picture is rendered. Results are released by
    the vehicle's time alone, so that nothing depends on how fast the machine is. Implements ``types.Sensor``.
    ``camera`` is what it looks through; ``last_look`` the newest frame that was answered, with the answer.

    ``patience_s`` is how long, in wall time, a due answer is waited for. With 0, for vehicles whose time does
    not wait, it is handed on when it is there, no picture is taken while one is late, and ``exposures``
    become rarer while looks take longer than their period.
    """

    def __init__(
        self,
        camera: Camera,
        detector: Detector,
        exposures: Exposures,
        latency_s: float,
        patience_s: float = PATIENCE_S,
    ) -> None:
        self.camera = camera
        self._detector = detector
        self._exposures = exposures
        self._latency_s = latency_s
        self._patience_s = patience_s
        self._usual_patience_s = patience_s
        self._pace = Pace(exposures)
        self._timed_s = -math.inf  # exposure of the newest look whose time was taken
        self._answered_s = -math.inf  # when it was answered
        self._seen_s = -math.inf  # the newest state
        self._pending: deque[tuple[Frame, Future[Detections]]] = deque()
        self._recalled: deque[Answer] = deque()
        self.last_look: tuple[Frame, Detections] | None = None
        self._asked: SimpleQueue[tuple[Frame, Future[Detections]] | None] = SimpleQueue()
        cv2.setNumThreads(1)  # its threads spin while they wait, on cores that renderer and detector need
        self._worker = Thread(target=self._answer_all, name="detector", daemon=True)
        self._worker.start()

    def recall(self, answers: Iterable[Answer]) -> None:
        """Give these answers to the first pictures instead of asking the detector, as in an earlier flight.

        Of these pictures only the last is taken; the frames of the others are empty. The camera must be a
        ``SkippingCamera``.
        """
        self._recalled = deque(answers)

    def sense(self, state: VehicleState) -> Detections | None:
        """Take a picture if one is due; return the oldest result whose time has come.

        Raises DetectorError where the detector failed on that picture, or did not answer.
        """
        if self._patience_s == 0.0:
            self._time_looks(state.time_s)
        believed = self._exposures.due(state)
        if believed is not None and not self._is_late(state):
            exposed = state._replace(camera=believed)
            self._pending.append(self._remember(exposed) if self._recalled else self._look(exposed))
        if not self._is_due(state) or (self._patience_s == 0.0 and not self._pending[0][1].done()):
            return None
        frame, answer = self._pending.popleft()
        self.last_look = frame, self._result(answer)
        return self.last_look[1]

    def close(self) -> None:
        """Let go of detector and camera; a detector that does not answer is left alone after a while."""
        for _, answer in self._pending:
            answer.cancel()
        self._interrupt()
        self._asked.put(None)
        self._worker.join(_FAREWELL_S)
        self.camera.close()

    def _look(self, exposed: VehicleState) -> tuple[Frame, Future[Detections]]:
        look = self.camera.capture(exposed), Future[Detections]()
        self._asked.put(look)
        return look

    def _remember(self, exposed: VehicleState) -> tuple[Frame, Future[Detections]]:
        assert isinstance(self.camera, SkippingCamera)
        known = self._recalled.popleft()
        frame = self.camera.skip(exposed) if self._recalled else self.camera.capture(exposed)
        answer: Future[Detections] = Future()
        try:
            answer.set_result(known.to(frame))
        except DetectorError as error:
            answer.set_exception(error)
        return frame, answer

    def _answer_all(self) -> None:
        """The detector's thread. It is a daemon, so that one that hangs does not keep the program alive."""
        while (look := self._asked.get()) is not None:
            frame, answer = look
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(_sound(self._detector.detect(frame)))
                except Exception as error:
                    answer.set_exception(error)

    def _interrupt(self) -> None:
        if isinstance(self._detector, InterruptibleDetector):
            self._detector.interrupt()

    def _time_looks(self, now_s: float) -> None:
        """Tell the pace how long the looks took that were answered since the last time."""
        for frame, answer in self._pending:
            if frame.time_s > self._timed_s and answer.done():
                begun_s = max(frame.time_s, self._answered_s)
                self._answered_s = 0.5 * (max(self._seen_s, begun_s) + now_s)
                if answer.exception() is None:
                    self._pace.took(self._answered_s - begun_s)
                self._timed_s = frame.time_s
        self._seen_s = now_s

    def _is_due(self, state: VehicleState) -> bool:
        return bool(self._pending) and state.time_s >= self._pending[0][0].time_s + self._latency_s - _EPS_S

    def _is_late(self, state: VehicleState) -> bool:
        return self._patience_s == 0.0 and self._is_due(state) and not self._pending[0][1].done()

    def _result(self, answer: Future[Detections]) -> Detections:
        try:
            found = answer.result(self._patience_s)
        except DetectorError:
            raise
        except TookTooLong:
            answer.cancel()
            self._interrupt()
            self._patience_s = min(self._patience_s, _LITTLE_PATIENCE_S)
            raise DetectorError("no answer") from None
        except Exception as error:
            raise DetectorError(f"{type(error).__name__}: {error}") from error
        self._patience_s = self._usual_patience_s
        return found


def _sound(found: Detections) -> Detections:
    """What a detector found. Raises ValueError where it is no list of boxes."""
    numbers = np.column_stack([found.boxes_xyxy_px, found.confidences])
    if numbers.shape != (len(found.class_names), 5) or not np.isfinite(numbers).all():
        raise ValueError("boxes, confidences and names do not match, or are not finite")
    return found
