"""The factors that shift the score of a look, for the fit, the draws, the sensor files and the docs."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

VIEW_MAX = math.sin(math.radians(50.0)) ** 2
HIDDEN_MAX = 0.75  # by anything, including the picture's edge
BLUR_MAX = 1.0
TOO_SMALL = 0.8  # of the smallest measured size in pixels: below it nothing is reported
CUT_MIN = 0.01  # least share beyond an edge that cuts an object
EDGE_PX = 8.0  # objects this small look the same there
NEAR_PX = (8.0, 64.0)  # between which more and more of an object's side shows
COMPANY_PX = 4.0  # what spans fewer is no company: the detector hardly sees it
LENS_OCTAVES = (0.0, 3.0)  # of the focal length over the calibrated one, between which it was measured
CONTRAST_USUAL, CONTRAST_UNIT, CONTRAST_LIMITS = 30.0, 20.0, (-1.5, 3.0)

_NEAR_AT = math.log(NEAR_PX[0])
_NEAR_OVER = math.log(NEAR_PX[1]) - _NEAR_AT


class Factor(NamedTuple):
    """One factor: the score's mean rises by what it ``says`` times its number in the sensor file."""

    name: str
    says: str
    prior: tuple[float, float]  # of that number: mean and standard deviation
    limit: float = 6.0  # of that number, to either side


FACTORS = (  # in the order of ``factors_of_look``
    Factor("view", "sin² of the line of sight's angle off the vertical", (0.0, 0.6)),
    Factor("front", "cosine of the angle between where it faces and the line to the camera", (0.0, 1.0)),
    Factor("front_near", "the same, times log(pixels / 8) / log(8), from 0 to 1", (0.0, 1.5)),
    Factor("hidden", "share of the object that trees and buildings hide", (-0.7, 0.6)),
    Factor("cut", "square of the share of it beyond the picture's edge", (-0.7, 1.2)),
    Factor("edge_y", "1 - 8 / pixels, at least 0, where the upper or lower edge cuts it; else 0", (0.0, 0.6)),
    Factor(
        "beside", "1 right beside a tree's or bush's crown, less regular than its solid; else 0", (0.0, 0.4)
    ),
    Factor("shade", "share of the object in the shadow of trees and buildings", (-0.5, 0.6)),
    Factor("blur", "length of the motion blur over the object's pixels", (-0.3, 0.6)),
    Factor("contrast", "difference in colour to the ground (CIE76), less 30, over 20", (0.0, 0.2), 1.5),
    Factor("company", "log(1 + the number of other objects in the picture)", (0.0, 0.3), 1.5),
)
NAMES = tuple(factor.name for factor in FACTORS)


@njit(cache=True)
def factors_of_look(
    view: float,
    front: float,
    pixels: float,
    hidden: float,
    cut: float,
    is_cut_y: bool,
    beside: float,
    shade: float,
    blur_px: float,
    contrast: float,
    others: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """The FACTORS of one look.

    ``view`` is a squared sine, ``front`` a cosine; ``hidden``, ``cut`` and ``shade`` are shares; ``contrast``
    is in CONTRAST_UNIT from CONTRAST_USUAL, ``others`` are the other objects in the picture that span
    COMPANY_PX.
    """
    nearness = min(max((math.log(pixels) - _NEAR_AT) / _NEAR_OVER, 0.0), 1.0)
    return (
        min(view, VIEW_MAX),
        front,
        front * nearness,
        hidden,
        cut * cut,
        max(1.0 - EDGE_PX / pixels, 0.0) if is_cut_y else 0.0,
        beside,
        shade,
        min(blur_px / pixels, BLUR_MAX),
        contrast,
        math.log1p(others),
    )
