"""The camera of a running Gazebo, such as PX4's: the newest picture of a topic."""

from __future__ import annotations

import os
import threading
import time
from typing import Any
from urllib.parse import urlparse

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.gazebo import gz_sim, lockstep
from skysweep.gazebo.messages import ImageStamped, type_name
from skysweep.gazebo.transport import Transport, TransportError
from skysweep.geometry.camera import Lens
from skysweep.types import Frame, VehicleState

CLASSIC, GZ = "gazebo:", "gz:"  # prefix of a source; the topic follows
OPEN_S = 10.0  # until the first picture
FRESH_S = 1.0  # for each further picture
_READ_S = 0.2  # until a reader notices that it is closed
MASTER_VARIABLE, MASTER_DEFAULT = "GAZEBO_MASTER_URI", "http://127.0.0.1:11345"


class LiveCamera:
    """The newest picture of ``gazebo:TOPIC`` (Classic, at GAZEBO_MASTER_URI) or ``gz:TOPIC`` (gz-sim).

    Implements ``types.Camera``; the frame carries the pose of the state. The lens is the scenario's, so the
    pictures must have its size. Raises UserError if no Gazebo runs, the topic does not exist or shows nothing
    in OPEN_S, or its pictures have another size or encoding.
    """

    def __init__(self, source: str, lens: Lens) -> None:
        self._source, self._lens = source, lens
        kind, _, self._topic = source.partition(":")
        self.renderer: str | None = kind
        if not source.startswith((CLASSIC, GZ)):
            raise UserError(f"--camera {source}: write {CLASSIC}TOPIC or {GZ}TOPIC")
        try:
            self._pictures = self._open(OPEN_S)
            try:
                self._check(self._pictures.newest(OPEN_S))
            except BaseException:
                self.close()
                raise
        except TransportError as error:
            raise UserError(f"--camera {source}: {error}; is Gazebo running?") from None

    def capture(self, state: VehicleState) -> Frame:
        """The newest picture; reconnects after a restart of Gazebo.

        Raises ConnectionError if none comes within FRESH_S.
        """
        try:
            image = self._pictures.newest(FRESH_S)
        except TransportError:
            image = self._again()
        if image is None:
            raise ConnectionError(f"{self._source} shows no picture for {FRESH_S:g} s")
        return Frame(state.time_s, image, state.camera, self._lens)

    def close(self) -> None:
        """Disconnects; the simulation continues."""
        self._pictures.close()

    def _open(self, patience_s: float) -> _ClassicPictures | _GzPictures:
        if self._source.startswith(CLASSIC):
            return _ClassicPictures(self._topic, patience_s)
        return _GzPictures(self._topic)

    def _check(self, first: NDArray[np.uint8] | None) -> None:
        if first is None:
            raise UserError(
                f"--camera {self._source}: shows no picture in {OPEN_S:g} s; is the simulation paused?"
            )
        height, width = first.shape[:2]
        if (width, height) != (self._lens.width_px, self._lens.height_px):
            raise UserError(
                f"--camera {self._source}: its pictures are {width} x {height}; write camera.width_px: "
                f"{width}, camera.height_px: {height} and the hfov_rad of that picture"
            )

    def _again(self) -> NDArray[np.uint8] | None:
        self.close()
        try:
            self._pictures = self._open(FRESH_S)
            return self._pictures.newest(FRESH_S)
        except (TransportError, UserError) as error:  # its topics may not be there yet
            raise ConnectionError(f"{self._source}: {error}") from error


class _ClassicPictures:
    """Reads all the time and keeps the newest message: unread ones would queue in gzserver and get old."""

    def __init__(self, topic: str, patience_s: float) -> None:
        master = urlparse(os.environ.get(MASTER_VARIABLE) or MASTER_DEFAULT)
        self._topic = topic
        self._transport = Transport(master.port or 11345, patience_s, master.hostname or "127.0.0.1")
        try:
            self._subscribe(patience_s)
        except BaseException:
            self._transport.close()
            raise
        self._news = threading.Condition()
        self._message: Any = None
        self._error: TransportError | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._read, name="gazebo-camera", daemon=True)
        self._thread.start()

    def _subscribe(self, patience_s: float) -> None:
        transport, topic = self._transport, self._topic
        give_up = time.monotonic() + patience_s
        while topic not in transport.topics() and time.monotonic() < give_up:
            transport.receive(0.1)
        images = {t for t, kind in transport.topics().items() if kind == type_name(ImageStamped)}
        if topic not in images:
            there = ", ".join(sorted(images)) or "none"
            raise UserError(f"--camera {CLASSIC}{topic}: no such image topic; there are: {there}")
        transport.subscribe(topic, ImageStamped)

    def newest(self, timeout_s: float) -> NDArray[np.uint8] | None:
        """The newest picture not returned before; None if none comes. Raises TransportError."""
        with self._news:
            self._news.wait_for(lambda: self._message or self._error, timeout_s)
            if self._message is None and self._error is not None:
                raise self._error
            message, self._message = self._message, None
        return None if message is None else lockstep.image_of(message.image, self._topic)

    def close(self) -> None:
        self._closing = True
        self._thread.join()
        self._transport.close()

    def _read(self) -> None:
        try:
            while not self._closing:
                received = self._transport.receive(_READ_S)
                if received is not None:
                    with self._news:
                        self._message = received[1]
                        self._news.notify_all()
        except (TransportError, OSError, DecodeError) as error:
            with self._news:
                self._error = TransportError(str(error))
                self._news.notify_all()


class _GzPictures:
    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._link = gz_sim.GzLink()
        self._link.subscribe_images(topic)
        self.close = self._link.close

    def newest(self, timeout_s: float) -> NDArray[np.uint8] | None:
        message = self._link.image(-1.0, timeout_s)
        while message is not None and (newer := self._link.image(-1.0, 0.0)) is not None:
            message = newer
        return None if message is None else gz_sim.image_of(message, self._topic)
