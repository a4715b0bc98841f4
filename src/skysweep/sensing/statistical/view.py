"""How a detector sees a camera's pictures: in which of its own pixels, and in which tiles.

What a detector makes of a thing depends on the pixels that it gets, after a picture, or a tile of it, was
scaled to the model's input. They are measured in pixels of the calibrated pictures: a scale of 1 shows things
as those did. A picture that is enlarged holds no more than before, but the detector makes a little more of
it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from skysweep.arrays import F64
from skysweep.detection.halving import halved_below_m, n_halvings
from skysweep.detection.layouts import Told
from skysweep.detection.model_files import existing_model_file, sha256_of
from skysweep.detection.tiling import FixedSides, fitting_scale, input_hw_for, takes_any_size, tiles_px
from skysweep.geometry.camera import Lens
from skysweep.scenarios.model import CameraModel, DetectorModel

Size = tuple[int, int]  # width, height
_GAIN = 1.0 / 3.0  # of the log of an enlargement: measured at 1.8 times, at 640 x 360 and 1280 x 720


class View(NamedTuple):
    """A camera's pictures in the calibrated pixels."""

    scale: float  # for one pixel of the camera
    focal_px: float
    width_px: float
    height_px: float
    tiles_px: F64  # (T, 4) left, top, right and bottom of each
    enlarged: float  # times that the detector enlarges the camera's pixels, at least 1
    as_high: float  # times an altitude: from where a calibrated pixel shows as much ground
    below_m: tuple[float, ...] = ()  # heights below which pictures are halved once, twice and so on
    halved: tuple[View, ...] = ()  # how they are seen then

    @classmethod
    def of(
        cls, camera: CameraModel, detector: DetectorModel, calibrated: Lens, smallest_m: float = 0.0
    ) -> View:
        """The view of this camera by a detector that was calibrated, untiled, with that lens.

        ``smallest_m`` is the size of the smallest target; with 0 no picture is halved. Raises UserError where
        the size of the detector's input is asked for and its file cannot be read.
        """
        below_m = halved_below_m(camera, detector, smallest_m)
        if below_m and not takes_any_size(_input_of(detector)[0]):
            below_m = ()
        whole, *halved = (
            cls._of_halved(camera, detector, calibrated, halvings) for halvings in range(1 + len(below_m))
        )
        return whole._replace(below_m=below_m, halved=tuple(halved))

    @classmethod
    def _of_halved(
        cls, camera: CameraModel, detector: DetectorModel, calibrated: Lens, halvings: int
    ) -> View:
        lens, scale, enlarged = camera.lens, 1.0, 1.0
        size_px = lens.width_px >> halvings, lens.height_px >> halvings
        calibrated_px = calibrated.width_px, calibrated.height_px
        focal_px = lens.focal_px * size_px[0] / lens.width_px
        if (size_px, detector.tiles) != (calibrated_px, 1):
            given = _input_scale(detector, size_px, detector.tiles) / _input_scale(detector, calibrated_px, 1)
            enlarged = max(given, 1.0)
            scale = min(given, enlarged**_GAIN)
        tiles = scale * np.array(tiles_px(*size_px, detector.tiles), dtype=float)
        focal_px, width_px, height_px = (px * scale for px in (focal_px, *size_px))
        of_camera, as_high = scale * size_px[0] / lens.width_px, calibrated.focal_px / focal_px
        return cls(of_camera, focal_px, width_px, height_px, tiles, enlarged, as_high)

    def at(self, height_agl_m: float) -> View:
        """That of pictures from this height."""
        halvings = n_halvings(self.below_m, height_agl_m)
        return self.halved[halvings - 1] if halvings else self

    def pixels_on_target(self, size_m: float, distance_m: float) -> float:
        """Of an object that is seen face-on."""
        return self.focal_px * size_m / distance_m


def _input_scale(detector: DetectorModel, size_px: Size, tiles: int) -> float:
    """The pixels of the detector's input for one of a picture of this size."""
    left, top, right, bottom = tiles_px(*size_px, tiles)[0]
    fixed_hw, stride = _input_of(detector)
    return fitting_scale((bottom - top, right - left), input_hw_for(fixed_hw, size_px[::-1], stride))


def _input_of(detector: DetectorModel) -> tuple[FixedSides, int]:
    """The sides of the detector's input that are fixed, and of what the others are multiples."""
    path = existing_model_file(detector.model)
    told = Told(detector.boxes, detector.pixels, detector.channels)
    return _input_of_file(str(path), sha256_of(path), told)


@lru_cache(maxsize=16)
def _input_of_file(path: str, _sha256: str, told: Told) -> tuple[FixedSides, int]:
    from skysweep.detection.yolo import YoloDetector  # imported late: it loads ONNX Runtime

    network = YoloDetector(path, **told._asdict()).network
    return network.fixed_hw, network.stride
