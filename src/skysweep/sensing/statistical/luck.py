"""What looks tell of an object's luck with the detector, beside what the sensor model expects of it.

One share of the variance of an object's scores is its own, in every look; another is common to the looks of
one passing. Ten looks in passing are therefore not ten independent ones. A belief is a row of N_STATES
numbers: a Gaussian of these two offsets, and the log likelihood of all looks. Every look multiplies it: a hit
by the density of its score; a miss by the chance that the score stayed below the detector's threshold (a
Tobit model: Tobin, Econometrica 26, 1958), and the offsets get the moments of the truncated normal
distribution.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from skysweep.arrays import F64

N_STATES = 7
WEIGHT, OWN, PASS, OWN_VAR, COVARIANCE, PASS_VAR, PIXELS = range(N_STATES)  # PIXELS: in the last look

_OUTLIER, _OUTLIER_DENSITY = 0.03, 0.2  # share of hits whose score nothing explains, and where they lie


def unseen(shape: tuple[int, ...]) -> F64:
    """The beliefs (*shape, N_STATES) of objects that nobody has looked at."""
    belief = np.zeros((*shape, N_STATES))
    belief[..., OWN_VAR] = belief[..., PASS_VAR] = 1.0
    belief[..., PIXELS] = np.nan
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
        b[WEIGHT] += math.log(1.0 - lapse) + math.log(total)
        share = explained / total
        gain, narrowed = share * (score - middle), share
    else:
        sigma = math.sqrt(variance)
        z = (threshold - middle) / sigma
        below = max(0.5 * math.erfc(-z / math.sqrt(2.0)), 1e-12)
        missed = lapse + (1.0 - lapse) * below
        b[WEIGHT] += math.log(missed)
        share = (1.0 - lapse) * below / missed
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
