"""The effects of a thermal camera with an uncooled sensor: optics, lag, noise, automatic gain, JPEG.

The randomness of a frame depends on (seed, frame index) alone, so frames can be made in any order.
"""

from __future__ import annotations

import cv2
import numpy as np

from skysweep.arrays import F32, F64, U8
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.sensing.cameras.effects import NOISE_PX, motion_blurred
from skysweep.worlds.rendering.white_hot import grey_rgb, white_hot

OPTICS_PX = 0.5  # standard deviation of the blur: diffraction at f/1 and 10 um on pixels of 12 um
FIXED_SHARE = 0.5  # of the noise, again in every frame: what the last shutter left uncorrected


class ThermalEffects:
    """Turns rendered temperatures of one size into a thermal camera's pictures.

    ``time_constant_s`` is that of the sensor's pixels, which blurs as an exposure of that length does.
    """

    def __init__(
        self, lens: Lens, time_constant_s: float, netd_k: float, jpeg_quality: int, seed: int
    ) -> None:
        self._lens, self._time_constant_s, self._seed = lens, time_constant_s, seed
        self._quality = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
        rng = np.random.default_rng([seed, 61])
        size = lens.height_px + NOISE_PX, lens.width_px + NOISE_PX
        self._tile_k = rng.standard_normal(size, np.float32) * np.float32(netd_k)
        shape = lens.height_px, lens.width_px
        pattern = rng.standard_normal(shape, np.float32) + rng.standard_normal((1, shape[1]), np.float32)
        self._pattern_k = pattern * np.float32(FIXED_SHARE * netd_k / np.sqrt(2.0))

    def apply(
        self,
        heat_c: F32,
        frame_index: int,
        pose: CameraPose,
        velocity_enu_mps: F64,
        rate_enu_radps: F64,
        distance_m: float,
    ) -> U8:
        """The picture (H, W, 3), three equal channels, of temperatures (H, W) in degrees C.

        The camera moves and turns meanwhile; ``distance_m`` is as of ``CameraEffects.apply``.
        """
        rng = np.random.default_rng([self._seed, frame_index, 67])
        sharp = np.asarray(cv2.GaussianBlur(heat_c, (0, 0), OPTICS_PX), dtype=np.float32)
        motion = pose, velocity_enu_mps, rate_enu_radps, distance_m
        blurred = motion_blurred(sharp, self._lens, self._time_constant_s, *motion)
        y, x = rng.integers(0, NOISE_PX, 2)
        noise_k = self._tile_k[y : y + heat_c.shape[0], x : x + heat_c.shape[1]]
        grey = white_hot(np.asarray(blurred + noise_k + self._pattern_k, dtype=np.float32))
        _, packed = cv2.imencode(".jpg", grey, self._quality)
        unpacked = cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)
        assert unpacked is not None
        return grey_rgb(np.asarray(unpacked, dtype=np.uint8))
