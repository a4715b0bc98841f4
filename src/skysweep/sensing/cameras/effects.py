"""The effects of a real camera: motion blur, exposure, noise, JPEG. Milliseconds a frame.

The randomness of a frame depends on (seed, frame index) alone, so frames can be made in any order.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import F32, F64, U8
from skysweep.geometry.camera import CameraPose, Lens

EXPOSURE_STD = 0.05  # relative error of the automatic exposure
EXPOSURE_PERIOD = 20  # frames over which that error changes
MAX_BLUR_PX = 31
NOISE_PX = 128  # the noise tile is larger than the picture by this
_BAND_PX = 1088  # rows that one thread works on, in whole blocks of JPEG
_BLOCK_PX = 16  # of JPEG with halved colour; decoding smooths colours across its edges


class CameraEffects:
    """Turns clean renders of one size into photographs."""

    def __init__(self, lens: Lens, exposure_s: float, noise_std: float, jpeg_quality: int, seed: int) -> None:
        self._lens = lens
        self._exposure_s = exposure_s
        self._quality = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
        self._seed = seed
        self._threads = ThreadPoolExecutor(2)
        rng = np.random.default_rng([seed, 41])
        self._tile = np.empty((lens.height_px + NOISE_PX, lens.width_px + NOISE_PX, 3), np.int16)
        for row in self._tile:  # one by one: all at once would take four times as much memory
            unit = rng.normal(size=row.shape)
            unit[:, 1] *= 0.85  # green has twice the photosites
            row[:] = np.clip(np.round(unit * noise_std * 16), -2000, 2000)

    def apply(
        self,
        image: U8,
        frame_index: int,
        pose: CameraPose,
        velocity_enu_mps: F64,
        rate_enu_radps: F64,
        distance_m: float,
    ) -> U8:
        """The photograph (H, W, 3) of a render, taken while the camera moves and turns.

        ``distance_m`` to the ground along the optical axis scales the blur of translation.
        """
        rng = np.random.default_rng([self._seed, frame_index, 43])
        motion = pose, velocity_enu_mps, rate_enu_radps, distance_m
        blurred = motion_blurred(image, self._lens, self._exposure_s, *motion)
        curve = self._exposure_curve(frame_index, rng)
        y, x = rng.integers(0, NOISE_PX, 2)
        noise = self._tile[y : y + image.shape[0], x : x + image.shape[1]]
        photograph = np.empty_like(image)

        def develop(top: int) -> None:
            """One band, with the blocks beside it, so that it is as if the picture were made whole."""
            bottom, above = min(top + _BAND_PX, len(image)), max(top - _BLOCK_PX, 0)
            rows = slice(above, bottom + _BLOCK_PX)
            exposed = np.asarray(cv2.LUT(blurred[rows], curve), dtype=np.uint8)
            made = self._compress(_add_noise(exposed, noise[rows]))
            photograph[top:bottom] = made[top - above : bottom - above]

        list(self._threads.map(develop, range(0, len(image), _BAND_PX)))
        return photograph

    def _compress(self, image: U8) -> U8:
        _, packed = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), self._quality)
        unpacked = cv2.imdecode(packed, cv2.IMREAD_COLOR)
        assert unpacked is not None
        return np.asarray(cv2.cvtColor(unpacked, cv2.COLOR_BGR2RGB), dtype=np.uint8)

    def _exposure_curve(self, frame_index: int, rng: np.random.Generator) -> U8:
        """A slow drift of the automatic exposure plus jitter, as a table (256,)."""
        k, t = divmod(frame_index, EXPOSURE_PERIOD)
        a, b = (np.random.default_rng([self._seed, n, 47]).normal() for n in (k, k + 1))
        w = t / EXPOSURE_PERIOD
        gain = np.exp(EXPOSURE_STD * ((1 - w) * a + w * b) + 0.2 * EXPOSURE_STD * rng.normal())
        return np.asarray(np.clip(np.arange(256) * gain + 0.5, 0, 255).astype(np.uint8))


_SHOT = np.round(16 * (0.6 + 0.4 * np.sqrt(np.arange(256) / 64.0))).astype(np.uint8)


def _add_noise(image: U8, tile: NDArray[np.int16]) -> U8:
    level = cv2.LUT(image, _SHOT)  # read noise plus photon noise, which grows with the root of the light
    noise = cv2.multiply(tile, level, scale=1 / 256, dtype=cv2.CV_16S)
    return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U))


_Image = TypeVar("_Image", U8, F32)


def motion_blurred(
    image: _Image,
    lens: Lens,
    exposure_s: float,
    pose: CameraPose,
    velocity: F64,
    rate: F64,
    distance_m: float,
) -> _Image:
    """One directional kernel for the whole frame: the motion at the picture's centre.

    A point at (0, 0, Z) in the camera moves by f * (-v / Z - omega x z) on the sensor.
    """
    v, w = pose.R_camera_to_enu.T @ velocity, pose.R_camera_to_enu.T @ rate
    f = lens.focal_px * exposure_s
    dx, dy = f * (-v[0] / distance_m - w[1]), f * (-v[1] / distance_m + w[0])
    length = float(np.hypot(dx, dy))
    if length < 0.3:
        return image
    scale = min(1.0, MAX_BLUR_PX / length)
    return cast(_Image, cv2.filter2D(image, -1, blur_kernel(dx * scale, dy * scale)))


def blur_kernel(dx_px: float, dy_px: float) -> NDArray[np.float32]:
    """A line kernel of the motion (dx, dy) with subpixel weights that sum to 1."""
    half = int(np.ceil(max(abs(dx_px), abs(dy_px)) / 2)) + 1
    size = 2 * half + 1
    t = np.linspace(-0.5, 0.5, 8 * size)
    x, y = half + t * dx_px, half + t * dy_px
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    kernel = np.zeros((size, size))
    for ox, wx in ((0, 1 - (x - x0)), (1, x - x0)):
        for oy, wy in ((0, 1 - (y - y0)), (1, y - y0)):
            np.add.at(kernel, (np.minimum(y0 + oy, size - 1), np.minimum(x0 + ox, size - 1)), wx * wy)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)
