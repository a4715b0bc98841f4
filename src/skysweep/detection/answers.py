"""Checks of a detector's answers."""

from __future__ import annotations

from collections.abc import Container

import numpy as np
from numpy.typing import ArrayLike

from skysweep.types import Detections

MAX_BOXES = 300  # in one look, as YOLO exports keep; more mean a broken model
_ROUNDING = 1e-3  # of a confidence in half precision


def sound(found: Detections, class_names: Container[str]) -> Detections:
    """``found`` itself. Raises ValueError if a detector with these classes cannot answer that."""
    n = len(found.class_names)
    if np.shape(found.boxes_xyxy_px) != (n, 4) or np.shape(found.confidences) != (n,):
        raise ValueError("boxes, confidences and names do not match")
    refuse_nonsense(found.boxes_xyxy_px, found.confidences)
    unknown = [name for name in found.class_names if name not in class_names]
    if unknown:
        raise ValueError(f"there is no class {unknown[0]!r}")
    if n > MAX_BOXES:
        raise ValueError(f"{n} boxes in one picture, more than {MAX_BOXES}")
    return found


def refuse_nonsense(boxes_xyxy_px: ArrayLike, confidences: ArrayLike) -> None:
    """Raises ValueError if boxes (N, 4) or confidences (N,) are invalid."""
    boxes, sure = np.asarray(boxes_xyxy_px, dtype=float), np.asarray(confidences, dtype=float)
    if not (np.isfinite(boxes).all() and np.isfinite(sure).all()):
        raise ValueError("boxes or confidences are not finite")
    false = np.abs(sure - 0.5) > 0.5 + _ROUNDING
    if false.any():
        raise ValueError(f"the confidence {sure[false][0]:.3g} is not between 0 and 1")
    if (boxes[:, 2:] <= boxes[:, :2]).any():
        raise ValueError("a box has no extent")
