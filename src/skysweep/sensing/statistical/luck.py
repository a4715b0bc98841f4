"""What looks tell of an object's luck with the detector, beside what the sensor model expects of it.

One share of the variance of an object's scores is its own, in every look; another is common to the looks of
one passing. Ten looks in passing are therefore not ten independent ones. A belief is a row of N_STATES
numbers: a Gaussian of these two offsets, and the log likelihood of all looks. Every look multiplies it: a hit
by the density of its score; a miss by the chance that the score stayed below the detector's threshold (a
Tobit model: Tobin, Econometrica 26, 1958), and the offsets get the moments of the truncated normal
distribution.

Nor are lapses independent. An object that lapses somewhere lapses wherever lapses are at least as frequent;
so does a pass, of the objects that do not. A pass's fade: with a chance the next look is like another pass's.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skysweep.arrays import F64

N_STATES = 12
WEIGHT, OWN, PASS, OWN_VAR, COVARIANCE, PASS_VAR, PIXELS = range(7)  # PIXELS: in the last look
LAPSE, PASS_LAPSES, LEAST, EVER_LAPSES, NOW_LAPSES = range(7, N_STATES)
# LAPSE: the chance of one in the last look. PASS_LAPSES: that its pass does, if the object does not.
# LEAST: the least chance of the object's own lapse in any look. EVER_LAPSES: that it lapses there, too.
# NOW_LAPSES: that it does in the last look, but not there.
# After a hit EVER_LAPSES is 0, and LEAST the largest chance without a lapse.

_OUTLIER, _OUTLIER_DENSITY = 0.03, 0.2  # share of hits whose score nothing explains, and where they lie


def unseen(shape: tuple[int, ...]) -> F64:
    """The beliefs (*shape, N_STATES) of objects that nobody has looked at."""
    belief = np.zeros((*shape, N_STATES))
    belief[..., OWN_VAR] = belief[..., PASS_VAR] = 1.0
    belief[..., PIXELS] = np.nan
    belief[..., LEAST] = belief[..., EVER_LAPSES] = 1.0
    return belief


@njit(cache=True)
def update(
    b: F64,
    pixels: float,
    moved_px: float,
    fade_px: float,
    mean: float,
    spread: float,
    lapse: float,
    object_share: float,
    pass_share: float,
    lapse_object_share: float,
    lapse_pass_share: float,
    unsure: float,
    score: float,
    threshold: float,
) -> tuple[float, float]:
    """Update one belief (N_STATES,) by a look, in place; mean and variance that it gave the score before.

    ``mean``, ``spread`` and ``lapse`` are what the sensor model expects of a look with so many ``pixels`` on
    the object; ``unsure`` is the standard deviation of that mean, the same in every look. ``moved_px`` is how
    far it has moved in the picture since its last look, inf where there was none in this passing. ``score``
    is NaN of a miss.
    """
    grown = abs(pixels - b[PIXELS]) if b[PIXELS] == b[PIXELS] else 0.0
    kept = math.exp(-(moved_px + grown) / fade_px)
    b[PIXELS] = pixels
    b[PASS] *= kept
    b[COVARIANCE] *= kept
    b[PASS_VAR] = kept * kept * b[PASS_VAR] + 1.0 - kept * kept
    of_object, of_object_before = lapse_object_share * lapse, lapse_object_share * b[LAPSE]
    of_pass = lapse_pass_share * lapse / (1.0 - of_object)
    of_pass_before = lapse_pass_share * b[LAPSE] / (1.0 - of_object_before)
    least = _move_object(b, of_object_before, of_object)
    object_lapses = b[EVER_LAPSES] + b[NOW_LAPSES]
    still_lapses = kept * b[PASS_LAPSES] + (1.0 - kept) * of_pass_before
    pass_lapses = _at_another(still_lapses, of_pass_before, of_pass)
    look_lapses = 1.0 - (1.0 - lapse) / ((1.0 - of_object) * (1.0 - of_pass))
    b[LAPSE] = lapse
    own = math.sqrt(object_share * spread * spread + unsure * unsure)
    common = math.sqrt(pass_share) * spread
    rest = max(1.0 - object_share - pass_share, 0.02) * spread * spread
    c_own = own * b[OWN_VAR] + common * b[COVARIANCE]
    c_pass = own * b[COVARIANCE] + common * b[PASS_VAR]
    variance = own * c_own + common * c_pass + rest
    middle = mean + own * b[OWN] + common * b[PASS]
    if score == score:
        density = math.exp(-0.5 * (score - middle) ** 2 / variance) / math.sqrt(2.0 * math.pi * variance)
        explained = (1.0 - _OUTLIER) * density
        total = explained + _OUTLIER * _OUTLIER_DENSITY
        answers = (1.0 - object_lapses) * (1.0 - pass_lapses) * (1.0 - look_lapses)
        b[WEIGHT] += math.log(answers) + math.log(total)
        b[LEAST], b[EVER_LAPSES], b[NOW_LAPSES], b[PASS_LAPSES] = least, 0.0, 0.0, 0.0
        share = explained / total
        gain, narrowed = share * (score - middle), share
    else:
        sigma = math.sqrt(variance)
        z = (threshold - middle) / sigma
        below = max(0.5 * math.erfc(-z / math.sqrt(2.0)), 1e-12)
        lapses = 1.0 - (1.0 - pass_lapses) * (1.0 - look_lapses)
        missed = lapses + (1.0 - lapses) * below  # if the object does not lapse
        share = (1.0 - lapses) * below / missed
        in_all = object_lapses + (1.0 - object_lapses) * missed
        b[WEIGHT] += math.log(in_all)
        b[EVER_LAPSES] /= in_all
        b[NOW_LAPSES] /= in_all
        b[PASS_LAPSES] = pass_lapses / missed
        hazard = math.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) / below
        gain = -share * sigma * hazard
        narrowed = share * min(max(hazard * (z + hazard), 0.0), 1.0)
    k_own, k_pass = c_own / variance, c_pass / variance
    b[OWN] += k_own * gain
    b[PASS] += k_pass * gain
    b[OWN_VAR] -= narrowed * k_own * c_own
    b[COVARIANCE] -= narrowed * k_own * c_pass
    b[PASS_VAR] -= narrowed * k_pass * c_pass
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
    """The chance that a pass that lapses with a chance, ``before`` in general, does where it is ``now``."""
    if now < before:
        return lapses * now / before
    return lapses + (1.0 - lapses) * (now - before) / (1.0 - before)
