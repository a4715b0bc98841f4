"""What cameras make of a scene: tones, colours, haze and sharpening, as widely as real ones differ."""

from __future__ import annotations

import cv2
import numpy as np

from skysweep.arrays import F32, U8

CONTRAST = (35.0, 80.0)  # standard deviation of the brightness that a camera's tone curve strives for
MOST_GAIN = 3.2  # it does not stretch a flat scene further
SATURATION = (0.2, 1.2)
HAZE_SHARE, MOST_HAZE = 0.3, 0.4
SHARPENED_SHARE, MOST_SHARPENING = 0.6, 1.5


def toned(picture: U8, rng: np.random.Generator) -> U8:
    """A picture (H, W, 3) with drawn haze, white balance, saturation, contrast and exposure."""
    p = picture.astype(np.float32) / 255.0
    if rng.random() < HAZE_SHARE:
        haze = rng.uniform(0.55, 0.85) * np.array([rng.uniform(0.9, 1.0), 0.97, rng.uniform(0.97, 1.08)])
        share = np.float32(rng.uniform(0.0, MOST_HAZE))
        p = (1 - share) * p + share * haze.astype(np.float32)
    p = p * np.exp(rng.normal(0, [0.04, 0.015, 0.05])).astype(np.float32)
    grey = p @ np.array([0.299, 0.587, 0.114], np.float32)
    colour = np.float32(rng.uniform(*SATURATION)) * (p - grey[..., None])
    wanted = float(np.exp(rng.uniform(*np.log(CONTRAST)))) / 255.0
    gain = float(np.clip(wanted / max(float(grey.std()), 1e-3), 0.8, MOST_GAIN))
    middle = float(np.clip(rng.normal(0.45, 0.12), 0.28, 0.75))
    stretched = _soft(middle + np.float32(gain) * (grey - np.median(grey)))
    return np.asarray(np.clip(np.rint(255.0 * (stretched[..., None] + colour)), 0, 255), np.uint8)


def _soft(values: F32) -> F32:
    """Values that bend into 0 and 1 over the outer fifths, as the shoulder and toe of a tone curve do."""
    knee = 0.2
    low, high = values < knee, values > 1 - knee
    out = values.copy()
    out[low] = knee * np.exp(np.minimum(values[low] - knee, 0.0) / knee)
    out[high] = 1 - knee * np.exp(-(values[high] - 1 + knee) / knee)
    return out


def sharpened(picture: U8, rng: np.random.Generator) -> U8:
    """The same with the bright and dark seams that sharpening leaves along edges."""
    if rng.random() >= SHARPENED_SHARE:
        return picture
    amount, width_px = rng.uniform(0.2, MOST_SHARPENING), rng.uniform(0.6, 1.6)
    p = picture.astype(np.float32)
    p += np.float32(amount) * (p - cv2.GaussianBlur(p, (0, 0), float(width_px)))
    return np.asarray(np.clip(np.rint(p), 0, 255), np.uint8)
