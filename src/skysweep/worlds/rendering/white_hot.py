"""Temperatures as grey levels: the automatic gain of a thermal camera, white hot."""

from __future__ import annotations

import cv2
import numpy as np

from skysweep.arrays import F32, U8
from skysweep.geometry.camera import CameraPose, Lens
from skysweep.scenarios.model import CameraModel
from skysweep.worlds.rendering.renderer import Renderer

LEAST_SPAN_K = 3.0  # shown with full contrast: the gain has an end, and an even scene stays even
_TAILS = (1.0, 99.0)  # percentiles between which grey is linear in temperature
_LINEAR = (40.0, 205.0)  # their grey levels; beyond, half of the rest within one more such span


def white_hot(heat_c: F32) -> U8:
    """Grey levels (H, W) of temperatures. Depends on this picture alone, unlike gains that settle slowly."""
    low, high = np.percentile(heat_c, _TAILS)
    spare_k = max(LEAST_SPAN_K - float(high - low), 0.0)
    low, high = low - spare_k / 2, high + spare_k / 2
    dark, bright = _LINEAR
    grey = dark + (heat_c - np.float32(low)) * np.float32((bright - dark) / (high - low))
    step = bright - dark  # of a span
    above, below = (np.maximum(d, 0.0) / step for d in (grey - bright, dark - grey))
    grey = (
        np.clip(grey, dark, bright) + (255.0 - bright) * above / (1.0 + above) - dark * below / (1.0 + below)
    )
    return np.asarray(np.rint(grey), dtype=np.uint8)


def seen(camera: CameraModel, renderer: Renderer, lens: Lens, pose: CameraPose, time_s: float = 0.0) -> U8:
    """The picture (H, W, 3) RGB of a camera of this kind through a lens, without noise or blur."""
    if camera.kind == "visible":
        return renderer.render(lens, pose, time_s)
    return grey_rgb(white_hot(renderer.render_heat_c(lens, pose, time_s)))


def grey_rgb(grey: U8) -> U8:
    """(H, W, 3) of three equal channels."""
    return np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
