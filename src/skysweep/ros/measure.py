"""Measures the cost of publishing pictures and the delay from a picture to its detections."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from skysweep.errors import UserError
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.link import RosLink
from skysweep.ros.parts import publish_frame
from skysweep.types import Frame

_LAST_ANSWERS_S = 2.0
_HFOV_RAD = 2.0
_SEED = 7


@dataclass(frozen=True, slots=True)
class Figures:
    """The measured cost and delay."""

    pictures: int
    answered: int
    core_share: float  # of one core, all threads of this process, while publishing
    latency_median_s: float  # from before publishing to the arrival of the detections; nan: none came
    latency_p95_s: float


def measure(
    link: RosLink, width_px: int, height_px: int, rate_hz: float, duration_s: float, patience_s: float
) -> Figures:
    """Publish a noisy picture at a rate and time the answers of a detector node.

    Raises UserError if nobody subscribes to the pictures or publishes detections within ``patience_s``.
    """
    link.advertise(topics.IMAGE, topics.CAMERA_INFO)
    answers = link.listen(topics.DETECTIONS.name, [m.DETECTIONS, m.MARKERS], patience_s)
    if not link.wait_for_listener(topics.IMAGE, patience_s):
        name = link.node.resolve_topic_name(topics.IMAGE.name)
        raise UserError(f"{name}: nobody subscribes; start a detector, such as  skysweep ros detect")
    image = np.random.default_rng(_SEED).integers(0, 255, (height_px, width_px, 3), dtype=np.uint8)
    pose, lens = CameraPose(np.zeros(3), np.eye(3)), Lens(width_px, height_px, _HFOV_RAD)
    sent_s: dict[int, float] = {}
    heard_s: dict[int, float] = {}

    def hear(until_s: float) -> None:
        time.sleep(max(0.0, until_s - time.monotonic()))
        for arrival in answers.take_all():
            stamp_s = m.detections_stamp(arrival.message)
            heard_s.setdefault(round((stamp_s or 0.0) * 1e6), arrival.arrived_s)

    began_s, cpu_s = time.monotonic(), time.process_time()
    for k in range(round(duration_s * rate_hz)):
        stamp_s = began_s + k / rate_hz
        sent_s[round(stamp_s * 1e6)] = time.monotonic()
        publish_frame(link, Frame(stamp_s, image, pose, lens))
        hear(began_s + (k + 1) / rate_hz)
    share = (time.process_time() - cpu_s) / (time.monotonic() - began_s)
    hear(time.monotonic() + _LAST_ANSWERS_S)
    delays = np.array([heard_s[key] - at for key, at in sent_s.items() if key in heard_s])
    median, p95 = np.percentile(delays, [50, 95]) if len(delays) else (np.nan, np.nan)
    return Figures(len(sent_s), len(delays), share, float(median), float(p95))
