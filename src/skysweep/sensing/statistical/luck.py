"""What looks tell of an object's luck with the detector, beside what the sensor model expects of it.

One share of the variance of an object's scores is its own, in every look; another is its aspect's, common to
looks from a like direction that show it equally large. Ten looks from one place are therefore not ten
independent ones, nor are two passings over it. A belief is a row of N_STATES numbers: a Gaussian of these two
offsets, the log likelihood of all looks, and the last one's aspect. Every look multiplies it: a hit
by the density of its score; a miss by the chance that the score stayed below the detector's threshold (a
Tobit model: Tobin, Econometrica 26, 1958), and the offsets get the moments of the truncated normal
distribution.

Nor are lapses independent. An object that lapses somewhere lapses wherever lapses are at least as frequent;
so does an aspect, of the objects that do not. Those fade: with a chance the next look is like another one's.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from skysweep.arrays import F64

N_STATES = 15
WEIGHT, OWN, ASPECT, OWN_VAR, COVARIANCE, ASPECT_VAR = range(6)
PIXELS, EAST, NORTH, UP = range(6, 10)  # in the last look: on the object, and the direction to the camera
LAPSE, ASPECT_LAPSES, LEAST, EVER_LAPSES, NOW_LAPSES = range(10, N_STATES)
# LAPSE: the chance of one in the last look. ASPECT_LAPSES: that its aspect does, if the object does not.
# LEAST: the least chance of the object's own lapse in any look. EVER_LAPSES: that it lapses there, too.
# NOW_LAPSES: that it does in the last look, but not there.
# After a hit EVER_LAPSES is 0, and LEAST the largest chance without a lapse.

_OUTLIER, _OUTLIER_DENSITY = 0.03, 0.2  # share of hits whose score nothing explains, and where they lie


def unseen(shape: tuple[int, ...]) -> F64:
    """The beliefs (*shape, N_STATES) of objects that nobody has looked at."""
    belief = np.zeros((*shape, N_STATES))
    belief[..., OWN_VAR] = belief[..., ASPECT_VAR] = 1.0
    belief[..., PIXELS] = np.nan
    belief[..., LEAST] = belief[..., EVER_LAPSES] = 1.0
    return belief


@njit(cache=True)
def kept(turned_rad: Any, grown: Any, fade_rad: float, fade_scale: float) -> Any:
    """Share of an aspect's luck that is left after a turn of the line of sight and a growth, a log.

    Numbers or arrays.
    """
    return np.exp(-turned_rad / fade_rad - np.abs(grown) / fade_scale)


@njit(cache=True)
def kept_since(
    b: F64, pixels: float, sight: tuple[float, float, float], fade_rad: float, fade_scale: float
) -> float:
    """The same since a belief's last look; 0 if there was none. A turn is taken as its chord."""
    if b[PIXELS] != b[PIXELS]:
        return 0.0
    x, y, z = sight[0] - b[EAST], sight[1] - b[NORTH], sight[2] - b[UP]
    turned, grown = math.sqrt(x * x + y * y + z * z), math.log(pixels / b[PIXELS])
    return float(kept(turned, grown, fade_rad, fade_scale))


@njit(cache=True)
def update(
    b: F64,
    pixels: float,
    sight: tuple[float, float, float],
    fade_rad: float,
    fade_scale: float,
    mean: float,
    spread: float,
    lapse: float,
    object_share: float,
    aspect_share: float,
    lapse_object_share: float,
    lapse_aspect_share: float,
    unsure: float,
    score: float,
    threshold: float,
) -> tuple[float, float]:
    """Update one belief (N_STATES,) by a look, in place; mean and variance that it gave the score before.

    ``mean``, ``spread`` and ``lapse`` are what the sensor model expects of a look with so many ``pixels`` on
    the object; ``unsure`` is the standard deviation of that mean, the same in every look. ``sight`` is the
    direction from the object to the camera, of length 1. ``score`` is NaN of a miss.
    """
    left = kept_since(b, pixels, sight, fade_rad, fade_scale)
    b[PIXELS], b[EAST], b[NORTH], b[UP] = pixels, sight[0], sight[1], sight[2]
    b[ASPECT] *= left
    b[COVARIANCE] *= left
    b[ASPECT_VAR] = left * left * b[ASPECT_VAR] + 1.0 - left * left
    of_object, of_object_before = lapse_object_share * lapse, lapse_object_share * b[LAPSE]
    of_aspect = lapse_aspect_share * lapse / (1.0 - of_object)
    of_aspect_before = lapse_aspect_share * b[LAPSE] / (1.0 - of_object_before)
    least = _move_object(b, of_object_before, of_object)
    object_lapses = b[EVER_LAPSES] + b[NOW_LAPSES]
    still_lapses = left * b[ASPECT_LAPSES] + (1.0 - left) * of_aspect_before
    aspect_lapses = _at_another(still_lapses, of_aspect_before, of_aspect)
    look_lapses = 1.0 - (1.0 - lapse) / ((1.0 - of_object) * (1.0 - of_aspect))
    b[LAPSE] = lapse
    own = math.sqrt(object_share * spread * spread + unsure * unsure)
    common = math.sqrt(aspect_share) * spread
    rest = max(1.0 - object_share - aspect_share, 0.02) * spread * spread
    c_own = own * b[OWN_VAR] + common * b[COVARIANCE]
    c_aspect = own * b[COVARIANCE] + common * b[ASPECT_VAR]
    variance = own * c_own + common * c_aspect + rest
    middle = mean + own * b[OWN] + common * b[ASPECT]
    if score == score:
        density = math.exp(-0.5 * (score - middle) ** 2 / variance) / math.sqrt(2.0 * math.pi * variance)
        explained = (1.0 - _OUTLIER) * density
        total = explained + _OUTLIER * _OUTLIER_DENSITY
        answers = (1.0 - object_lapses) * (1.0 - aspect_lapses) * (1.0 - look_lapses)
        b[WEIGHT] += math.log(answers) + math.log(total)
        b[LEAST], b[EVER_LAPSES], b[NOW_LAPSES], b[ASPECT_LAPSES] = least, 0.0, 0.0, 0.0
        share = explained / total
        gain, narrowed = share * (score - middle), share
    else:
        sigma = math.sqrt(variance)
        z = (threshold - middle) / sigma
        below = max(0.5 * math.erfc(-z / math.sqrt(2.0)), 1e-12)
        lapses = 1.0 - (1.0 - aspect_lapses) * (1.0 - look_lapses)
        missed = lapses + (1.0 - lapses) * below  # if the object does not lapse
        share = (1.0 - lapses) * below / missed
        in_all = object_lapses + (1.0 - object_lapses) * missed
        b[WEIGHT] += math.log(in_all)
        b[EVER_LAPSES] /= in_all
        b[NOW_LAPSES] /= in_all
        b[ASPECT_LAPSES] = aspect_lapses / missed
        hazard = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / below
        gain = -share * sigma * hazard
        narrowed = share * min(max(hazard * (z + hazard), 0.0), 1.0)
    k_own, k_aspect = c_own / variance, c_aspect / variance
    b[OWN] += k_own * gain
    b[ASPECT] += k_aspect * gain
    b[OWN_VAR] -= narrowed * k_own * c_own
    b[COVARIANCE] -= narrowed * k_own * c_aspect
    b[ASPECT_VAR] -= narrowed * k_aspect * c_aspect
    return middle, variance


@njit(cache=True)
def _move_object(b: F64, before: float, now: float) -> float:
    """Take an object from where it lapses with a chance, of ``before`` in general, to where with ``now``.

    Returns that, or more if it is known not to lapse where more do.
    """
    if b[EVER_LAPSES] == 0.0:
        before, now = max(before, b[LEAST]), max(now, b[LEAST])
    if now < b[LEAST]:
        b[EVER_LAPSES] *= now / b[LEAST]
        b[NOW_LAPSES] = 0.0
        b[LEAST] = now
    elif now < before:
        b[NOW_LAPSES] *= (now - b[LEAST]) / (before - b[LEAST])
    else:
        b[NOW_LAPSES] += (1.0 - b[EVER_LAPSES] - b[NOW_LAPSES]) * (now - before) / (1.0 - before)
    return now


@njit(cache=True)
def _at_another(lapses: float, before: float, now: float) -> float:
    """The chance that what lapses with a chance, ``before`` in general, does where it is ``now``."""
    if now < before:
        return lapses * now / before
    return lapses + (1.0 - lapses) * (now - before) / (1.0 - before)
