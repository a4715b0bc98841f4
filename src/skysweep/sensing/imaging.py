"""A camera and a detector as one sensor."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TookTooLong
from dataclasses import dataclass, replace
from queue import SimpleQueue
from threading import Thread
from typing import Protocol, runtime_checkable

import cv2

from skysweep.detection.answers import sound
from skysweep.errors import DetectorError, UserError
from skysweep.sensing.camera_watch import MEMORY_LOOKS, CameraWatch
from skysweep.sensing.exposures import Exposures, Pace
from skysweep.types import Answer, Camera, Detections, Detector, Doubt, Frame, VehicleState

_EPS_S = 1e-6
PATIENCE_S = 60.0  # of wall time, for an answer
_LITTLE_PATIENCE_S = 1.0  # after an answer that did not come
_FAREWELL_S = 5.0


@runtime_checkable
class SkippingCamera(Camera, Protocol):
    """A camera that can skip a picture without changing the next ones."""

    def skip(self, state: VehicleState) -> Frame:
        """The frame with an empty picture (0, 0, 3)."""
        ...


@runtime_checkable
class InterruptibleDetector(Detector, Protocol):
    """A detector whose look can be interrupted."""

    def interrupt(self) -> None:
        """Called from another thread; ``detect`` raises."""
        ...


@dataclass(frozen=True, slots=True)
class _Look:
    frame: Frame
    doubt: Doubt | None
    answer: Future[Detections]


class ImagingSensor:
    """Captures at the detector's rate and releases results ``latency_s`` after exposure.

    The detector runs in its own thread while the next picture is rendered. Results are released by the
    vehicle's time alone, so that none depends on the machine's speed. A ``watch`` judges every picture;
    without one all are trusted. Implements ``types.PictureSensor``.

    ``patience_s`` is the wall time to wait for a due answer. With 0, for vehicles in real time, answers are
    released when ready, no picture is taken while one is late, and ``exposures`` become rarer while looks
    take longer than their period.
    """

    def __init__(
        self,
        camera: Camera,
        detector: Detector,
        exposures: Exposures,
        latency_s: float,
        patience_s: float = PATIENCE_S,
        watch: CameraWatch | None = None,
    ) -> None:
        self.camera = camera
        self._watch = watch
        self._detector = detector
        self._exposures = exposures
        self._latency_s = latency_s
        self._patience_s = patience_s
        self._usual_patience_s = patience_s
        self._pace = Pace(exposures)
        self._timed_s = -math.inf  # exposure of the newest timed look
        self._answered_s = -math.inf  # when that was answered
        self._seen_s = -math.inf  # the newest state
        self._pending: deque[_Look] = deque()
        self._recalled: deque[Answer] = deque()
        self._retaken = 0  # how many of the last of those are captured again
        self.last_look: tuple[Frame, Detections] | None = None
        self._asked: SimpleQueue[tuple[Frame, Future[Detections]] | None] = SimpleQueue()
        cv2.setNumThreads(1)  # its waiting threads would spin on cores that renderer and detector need
        self._worker = Thread(target=self._answer_all, name="detector", daemon=True)
        self._worker.start()

    def recall(self, answers: Iterable[Answer]) -> None:
        """Replay these answers for the first pictures instead of asking the detector.

        Only the last of these pictures is captured, or those that the watch needs; the other frames are
        empty. The camera must be a ``SkippingCamera``.
        """
        self._recalled = deque(answers)
        self._retaken = _remembered(self._recalled) if self._watch is not None else 1

    def sense(self, state: VehicleState) -> Detections | None:
        """Take a picture if one is due; return the oldest result whose time has come.

        Raises DetectorError if the detector failed on that picture, or did not answer.
        """
        if self._patience_s == 0.0:
            self._time_looks(state.time_s)
        believed = self._exposures.due(state)
        if believed is not None and not self._is_late(state):
            exposed = state._replace(camera=believed)
            self._pending.append(self._remember(exposed) if self._recalled else self._look(exposed))
        if not self._is_due(state) or (self._patience_s == 0.0 and not self._pending[0].answer.done()):
            return None
        look = self._pending.popleft()
        self.last_look = look.frame, replace(self._result(look.answer), doubt=look.doubt)
        return self.last_look[1]

    def close(self) -> None:
        """Release detector and camera; a detector that hangs is abandoned after a while."""
        for look in self._pending:
            look.answer.cancel()
        self._interrupt()
        self._asked.put(None)
        self._worker.join(_FAREWELL_S)
        self.camera.close()

    def _look(self, exposed: VehicleState) -> _Look:
        frame = self.camera.capture(exposed)
        answer: Future[Detections] = Future()
        self._asked.put((frame, answer))  # first: the detector works while the watch judges
        return _Look(frame, self._judge(frame, exposed), answer)

    def _judge(self, frame: Frame, exposed: VehicleState) -> Doubt | None:
        return self._watch.judge(frame, exposed.R_body_to_enu[:, 2]) if self._watch is not None else None

    def _remember(self, exposed: VehicleState) -> _Look:
        assert isinstance(self.camera, SkippingCamera)
        if len(self._recalled) <= self._retaken:
            frame = self.camera.capture(exposed)
            self._judge(frame, exposed)
        else:
            frame = self.camera.skip(exposed)
        known = self._recalled.popleft()
        answer: Future[Detections] = Future()
        try:
            answer.set_result(known.to(frame))
        except DetectorError as error:
            answer.set_exception(error)
        return _Look(frame, known.doubt, answer)

    def _answer_all(self) -> None:
        """The detector's thread: a daemon, so that a detector that hangs does not keep the program alive."""
        while (look := self._asked.get()) is not None:
            frame, answer = look
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(sound(self._detector.detect(frame), self._detector.class_names))
                except Exception as error:
                    answer.set_exception(error)

    def _interrupt(self) -> None:
        if isinstance(self._detector, InterruptibleDetector):
            self._detector.interrupt()

    def _time_looks(self, now_s: float) -> None:
        """Tell the pace how long the newly answered looks took."""
        for look in self._pending:
            exposed_s = look.frame.time_s
            if exposed_s > self._timed_s and look.answer.done():
                begun_s = max(exposed_s, self._answered_s)
                self._answered_s = 0.5 * (max(self._seen_s, begun_s) + now_s)
                if look.answer.exception() is None:
                    self._pace.took(self._answered_s - begun_s)
                self._timed_s = exposed_s
        self._seen_s = now_s

    def _is_due(self, state: VehicleState) -> bool:
        if not self._pending:
            return False
        return state.time_s >= self._pending[0].frame.time_s + self._latency_s - _EPS_S

    def _is_late(self, state: VehicleState) -> bool:
        return self._patience_s == 0.0 and self._is_due(state) and not self._pending[0].answer.done()

    def _result(self, answer: Future[Detections]) -> Detections:
        try:
            found = answer.result(self._patience_s)
        except DetectorError:
            raise
        except UserError as error:
            raise DetectorError(str(error)) from error
        except TookTooLong:
            answer.cancel()
            self._interrupt()
            self._patience_s = min(self._patience_s, _LITTLE_PATIENCE_S)
            raise DetectorError("no answer") from None
        except Exception as error:
            raise DetectorError(f"{type(error).__name__}: {error}") from error
        self._patience_s = self._usual_patience_s
        return found


def _remembered(answers: Sequence[Answer]) -> int:
    """How many of the last pictures a watch must see again to regain its state."""
    trusted = 0
    for back, answer in enumerate(reversed(answers), start=1):
        trusted = trusted + 1 if answer.doubt is None and answer.failure is None else 0
        if trusted == MEMORY_LOOKS:
            return back
    return len(answers)
