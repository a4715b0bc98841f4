"""The camera of a Gazebo that somebody else runs, such as PX4's: the newest picture of a topic."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
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

CLASSIC, GZ = "gazebo:", "gz:"  # what a source begins with; the topic follows
OPEN_S = 10.0  # until the first picture has to come
FRESH_S = 1.0  # how long a picture may be awaited
_READ_S = 0.2  # until a closing reader looks up
MASTER_VARIABLE, MASTER_DEFAULT = "GAZEBO_MASTER_URI", "http://127.0.0.1:11345"

Newest = Callable[[float], NDArray[np.uint8] | None]  # waits so long for a picture that is new


class LiveCamera:
    """The newest picture of ``gazebo:TOPIC`` (Classic, at GAZEBO_MASTER_URI) or ``gz:TOPIC`` (gz-sim).

    Implements ``types.Camera``; the frame carries the pose of the state. The lens is the scenario's, so the
    pictures must have its size. Raises UserError when nothing runs there, the topic is not there, shows
    nothing in OPEN_S, or has pictures of another size or encoding.
    """

    def __init__(self, source: str, lens: Lens) -> None:
        self._source, self._lens = source, lens
        self.renderer: str | None = source.partition(":")[0]
        self._open: Callable[[float], tuple[Newest, Callable[[], None]]]
        if source.startswith(CLASSIC):
            self._open = lambda patience_s: _classic(source.removeprefix(CLASSIC), patience_s)
        elif source.startswith(GZ):
            self._open = lambda patience_s: _gz(source.removeprefix(GZ))
        else:
            raise UserError(f"--camera {source}: write {CLASSIC}TOPIC or {GZ}TOPIC")
        try:
            self._newest, self._close = self._open(OPEN_S)
        except TransportError as error:
            raise UserError(f"--camera {source}: {error}; is Gazebo running?") from None
        try:
            self._check_size()
        except BaseException:
            self.close()
            raise

    def capture(self, state: VehicleState) -> Frame:
        """The newest picture; connects again where Gazebo was started again.

        Raises ConnectionError when none comes within FRESH_S.
        """
        try:
            image = self._newest(FRESH_S)
        except TransportError:
            image = self._again()
        if image is None:
            raise ConnectionError(f"{self._source} shows no picture for {FRESH_S:g} s")
        return Frame(state.time_s, image, state.camera, self._lens)

    def close(self) -> None:
        """Let go of the connection; the simulation goes on."""
        self._close()

    def _check_size(self) -> None:
        try:
            first = self._newest(OPEN_S)
        except TransportError as error:
            raise UserError(f"--camera {self._source}: {error}; is Gazebo running?") from None
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
        self._close()
        try:
            self._newest, self._close = self._open(FRESH_S)
            return self._newest(FRESH_S)
        except (TransportError, UserError) as error:  # its topics may not be there yet
            raise ConnectionError(f"{self._source}: {error}") from error


def _classic(topic: str, patience_s: float) -> tuple[Newest, Callable[[], None]]:
    master = urlparse(os.environ.get(MASTER_VARIABLE) or MASTER_DEFAULT)
    transport = Transport(master.port or 11345, patience_s, master.hostname or "127.0.0.1")
    try:
        _subscribe(transport, topic, patience_s)
    except BaseException:
        transport.close()
        raise
    reader = _Reader(transport)

    def newest(timeout_s: float) -> NDArray[np.uint8] | None:
        message = reader.newest(timeout_s)
        return None if message is None else lockstep.image_of(message.image, topic)

    return newest, reader.close


def _subscribe(transport: Transport, topic: str, patience_s: float) -> None:
    give_up = time.monotonic() + patience_s
    while topic not in transport.topics() and time.monotonic() < give_up:
        transport.receive(0.1)
    images = {t for t, kind in transport.topics().items() if kind == type_name(ImageStamped)}
    if topic not in images:
        there = ", ".join(sorted(images)) or "none"
        raise UserError(f"--camera {CLASSIC}{topic}: no such image topic; there are: {there}")
    transport.subscribe(topic, ImageStamped)


class _Reader:
    """Reads all the time and keeps the newest message: what is not read waits in gzserver, and gets old."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._news = threading.Condition()
        self._message: Any = None
        self._error: TransportError | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._read, name="gazebo-camera", daemon=True)
        self._thread.start()

    def newest(self, timeout_s: float) -> Any:
        """The newest message that was not given yet, None when none came; raises TransportError."""
        with self._news:
            self._news.wait_for(lambda: self._message or self._error, timeout_s)
            if self._message is None and self._error is not None:
                raise self._error
            message, self._message = self._message, None
            return message

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


def _gz(topic: str) -> tuple[Newest, Callable[[], None]]:
    link = gz_sim.GzLink()
    link.subscribe_images(topic)

    def newest(timeout_s: float) -> NDArray[np.uint8] | None:
        message = link.image(-1.0, timeout_s)
        while message is not None and (newer := link.image(-1.0, 0.0)) is not None:
            message = newer
        return None if message is None else gz_sim.image_of(message, topic)

    return newest, link.close
