"""A real camera: a network stream (RTSP, UDP, HTTP), a V4L2 device or a video file, through OpenCV."""

from __future__ import annotations

import os
import threading
import time

import cv2
import numpy as np

from skysweep.errors import UserError
from skysweep.geometry.camera import Lens
from skysweep.types import Frame, VehicleState

OPEN_S = 10.0  # to wait for a stream's first picture
FRESH_S = 1.0  # greatest age of a picture
_DEVICE = "/dev/video"


class VideoCamera:
    """The newest picture of a video source. Implements ``types.Camera``.

    A thread reads all the time, so that nothing queues up; ``capture`` returns the last picture with the
    state's pose. Pictures must have the size of the scenario's lens. Raises UserError if ``source`` cannot be
    opened, shows nothing within ``OPEN_S``, or has another size.
    """

    def __init__(self, source: str, lens: Lens) -> None:
        self._source, self._lens = source, lens
        self.renderer: str | None = None
        self._video = cv2.VideoCapture()
        device = source.removeprefix(_DEVICE)
        is_device = source.startswith(_DEVICE) and device.isdigit()
        os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", "rtsp_transport;tcp|fflags;nobuffer")
        opened = self._video.open(int(device), cv2.CAP_V4L2) if is_device else self._video.open(source)
        if not opened:
            raise UserError(
                f"--camera {source}: cannot be opened; write rendered, rtsp://HOST/STREAM or /dev/video0"
            )
        if is_device:
            self._video.set(cv2.CAP_PROP_FRAME_WIDTH, lens.width_px)
            self._video.set(cv2.CAP_PROP_FRAME_HEIGHT, lens.height_px)
        self._newest: tuple[float, cv2.typing.MatLike] | None = None
        self._news = threading.Condition()
        self._running = True
        self._thread = threading.Thread(target=self._read, name="video", daemon=True)
        self._thread.start()
        try:
            self._check_size()
        except UserError:
            self.close()
            raise

    def capture(self, state: VehicleState) -> Frame:
        """The last picture. Raises ConnectionError if it is older than ``FRESH_S``."""
        with self._news:
            fresh = self._news.wait_for(self._is_fresh, FRESH_S)
            newest = self._newest
        if not fresh or newest is None:
            raise ConnectionError(f"{self._source} shows no picture for {FRESH_S:g} s")
        image = cv2.cvtColor(newest[1], cv2.COLOR_BGR2RGB).astype(np.uint8, copy=False)
        return Frame(state.time_s, image, state.camera, self._lens)

    def close(self) -> None:
        """Release the source."""
        self._running = False
        self._thread.join(timeout=2.0)
        self._video.release()

    def _is_fresh(self) -> bool:
        return self._newest is not None and time.monotonic() - self._newest[0] <= FRESH_S

    def _check_size(self) -> None:
        with self._news:
            if not self._news.wait_for(lambda: self._newest is not None, OPEN_S) or self._newest is None:
                raise UserError(
                    f"--camera {self._source}: shows no picture in {OPEN_S:g} s; is it streaming?"
                )
        height, width = self._newest[1].shape[:2]
        if (width, height) != (self._lens.width_px, self._lens.height_px):
            raise UserError(
                f"--camera {self._source}: its pictures are {width} x {height}; write camera.width_px: "
                f"{width}, camera.height_px: {height} and the hfov_rad of that picture"
            )

    def _read(self) -> None:
        while self._running:
            there, image = self._video.read()
            if not there:
                time.sleep(0.05)
                continue
            with self._news:
                self._newest = time.monotonic(), image
                self._news.notify_all()
