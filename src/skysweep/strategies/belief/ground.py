"""How well the ground was searched, and where looking again buys more than going home."""

from __future__ import annotations

import math
import zlib
from base64 import b64decode, b64encode

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from skysweep.arrays import F64
from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_camera_to_enu
from skysweep.sensing.statistical.cells import STILL
from skysweep.sensing.statistical.searched_area import motion_between
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.context import MissionContext
from skysweep.types import XY, Look

_CELLS_ACROSS, _MAX_CELLS = 4, 10_000
_WEIGHED = 4  # places at most that are weighed before the vehicle goes home
LOOKS_AGAIN = 2  # from such a place
_STOP_S = 3.0  # that braking and speeding up take
_LONGEST_GAP_S = 2.0  # between two looks: beyond, nobody knows how the camera moved


class Ground:
    """The probability of detection (POD) of each cell of the area, by the sensor model and all looks."""

    def __init__(self, context: MissionContext, parameters: BeliefParameters) -> None:
        search = context.search
        self._area = context.searched_area(_CELLS_ACROSS, _MAX_CELLS)
        self._missed_before = np.ones(self._area.inside.shape)  # share, in a flight that is resumed
        self._given_up = ~self._area.inside  # looked at again, or not worth it
        self._newest: Look | None = None
        self._missed_cost_s, self._speed_mps = parameters.missed_cost_s, parameters.check_speed_mps
        self._height_m, self._climbs_mps = search.scan_altitude_agl_m, context.vehicle.climb_speed_mps
        self._looks_s = _STOP_S + context.look_s
        self._R = rotation_camera_to_enu(context.yaw_rad, context.gimbal_pitch_rad)
        side_m = math.sqrt(math.prod(context.lens.footprint_m(self._height_m)))
        self._window = max(1, round(side_m / self._area.cell_m))  # cells that a picture is wide and high

    @property
    def pod(self) -> F64:
        """(R, C), row 0 the southernmost."""
        return np.asarray(1.0 - self._missed_before * (1.0 - self._area.cells.pod))

    def take(self, look: Look) -> None:
        """Take in a picture that was answered."""
        motion, newest = STILL, self._newest
        if newest is not None and 0.0 < look.time_s - newest.time_s <= _LONGEST_GAP_S:
            R = look.camera.R_camera_to_enu
            motion = motion_between(newest.camera, look.camera, R, look.time_s - newest.time_s)
        self._area.cells.look(look.camera, motion)
        self._newest = look

    def again(
        self, here: XY, above_m: float, found: float
    ) -> tuple[tuple[float, float, float], float, float] | None:
        """Where another look from the scan's height pays: the place, what it buys and what it takes, in s.

        ``found`` is the expected number of targets among the candidates. The search supposes that targets
        are as dense where it saw little: what it buys is the cost of missing those that it would report.
        """
        pod, xy = self.pod, self._area.centres_enu_m[..., :2]
        if not found or not pod.any():
            return None
        missed_s = self._missed_cost_s * found / pod.sum() * (1.0 - pod)
        away_s = np.linalg.norm(xy - here, axis=-1) / self._speed_mps
        climb_s = max(self._height_m - above_m, 0.0) / self._climbs_mps
        takes_s = np.maximum(away_s, climb_s) + self._looks_s
        for _ in range(_WEIGHED):
            in_view = uniform_filter(np.where(self._given_up, 0.0, missed_s), self._window, mode="constant")
            at_best_s = np.where(self._given_up, -np.inf, self._window**2 * in_view - takes_s)
            best = np.unravel_index(int(at_best_s.argmax()), pod.shape)
            if at_best_s[best] <= 0.0:
                return None
            x, y, z = self._area.centres_enu_m[best].tolist()
            eye = CameraPose(np.array([x, y, z + self._height_m]), self._R)
            buys_s = float((self._area.cells.promised(eye, LOOKS_AGAIN) * missed_s).sum())
            near_m = 0.5 * self._window * self._area.cell_m
            self._given_up |= (np.abs(xy - (x, y)) <= near_m).all(axis=-1)
            if buys_s > takes_s[best]:
                return (x, y, z), buys_s, float(takes_s[best])
        return None

    def snapshot(self) -> dict[str, str]:
        """As plain text: how well each cell was searched, to 1/255, and which were given up."""
        pod = np.rint(255.0 * self.pod).astype(np.uint8)
        return {"pod": _packed(pod), "given_up": _packed(np.packbits(self._given_up))}

    def restore(self, snapshot: dict[str, str]) -> None:
        """Go on from a snapshot."""
        shape = self._given_up.shape
        self._missed_before = 1.0 - _unpacked(snapshot["pod"]).reshape(shape) / 255.0
        bits = np.unpackbits(_unpacked(snapshot["given_up"]), count=self._given_up.size)
        self._given_up = bits.astype(bool).reshape(shape)


def _packed(numbers: NDArray[np.uint8]) -> str:
    return b64encode(zlib.compress(numbers.tobytes())).decode()


def _unpacked(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(zlib.decompress(b64decode(text)), dtype=np.uint8)
