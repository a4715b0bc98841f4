"""From looks to the numbers of the statistical sensor.

The score of a look is normal. Its mean is smooth over log pixels (second differences are penalised: Eilers
and Marx, Statistical Science 11, 1996) plus linear factors, one shift for each octave of the focal length and
one for each ground. Looks without a report are censored at the floor of the experiment. Each kind, pose and
class is fitted by penalised maximum likelihood twice: first on its own, then with the means over all kinds as
priors (partial pooling).

What looks have in common (``shares.py``) does not affect the fit of single looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar, nnls
from scipy.special import expit, gamma, ndtr
from scipy.stats import weibull_min

from skysweep.arrays import I64
from skysweep.experiments.calibration.looks import (
    CLASSES,
    CONFIDENCE_FLOOR,
    SUBJECTS,
    SURFACES,
    Background,
    ScoredLooks,
)
from skysweep.sensing.statistical.factors import (
    CONTRAST_LIMITS,
    CONTRAST_UNIT,
    CONTRAST_USUAL,
    FACTORS,
    NAMES,
    factors_of_look,
)
from skysweep.sensing.statistical.model import BackgroundModel, BoxModel, ContrastModel, KindModel, score_of
from skysweep.types import F64

GRID_PX = (4.0, 5.5, 7.5, 10.0, 14.0, 20.0, 28.0, 40.0, 57.0, 80.0, 113.0, 160.0, 220.0)
ALTITUDES_M = (3.0, 6.0, 12.0, 25.0, 50.0, 100.0)
MISSION_CONFIDENCE_MIN = 0.25
MIN_REPORTS, MIN_OBJECTS = 5, 3  # with fewer reports or objects a kind counts as never reported as the class

FLOOR_SCORE = float(score_of(CONFIDENCE_FLOOR))
_SPREAD_KNOTS_PX = (5.5, 20.0, 80.0)  # of its log, linear in between
_LAPSE_KNOTS_PX = (4.0, 7.5, 20.0)  # of its logit
_LOOK_WEIGHT = 0.7  # looks of one pass are alike: three carry about as much information as two
_CURVE_STD = 0.3  # of the second differences of the mean from node to node
_SLOPE_STD = 0.5  # of the first differences: the mean stays constant where nothing was seen
_MEAN = (-1.0, 2.0)  # prior of the mean
_SPREAD_STD = 0.4  # prior of the log spread
_USUAL_SPREAD = 0.4
_LENS, _GROUND = (0.0, 0.2), (0.0, 0.5)  # priors: mean and standard deviation, as those of the FACTORS
_N_FACTORS = len(FACTORS)
_OF_TREES = [NAMES.index(name) for name in ("hidden", "beside", "shade")]
_SHIFT_MEAN, _SHIFT_STD = np.array([f.prior for f in FACTORS] + [_LENS] + [_GROUND] * len(SURFACES)).T
_LAPSE = (-3.5, 2.0)  # prior of its logit
_AMONG = (1.0, 1.0)  # prior of what that rises by among trees
_LIMITS = (
    [(-9.0, 9.0)] * len(GRID_PX)
    + [(-2.3, 0.7)] * 3
    + [(-f.limit, f.limit) for f in FACTORS]
    + [(-6.0, 6.0)] * (1 + len(SURFACES))
    + [(-9.0, 2.0)] * 3
    + [(-1.0, 6.0)]
)
_N = len(GRID_PX)
_FIRST_SHIFT = _N + len(_SPREAD_KNOTS_PX)
_LAPSE_AT = _FIRST_SHIFT + len(_SHIFT_MEAN)
_AMONG_AT = _LAPSE_AT + len(_LAPSE_KNOTS_PX)
_RATE_CURVE_STD, _RATE_SLOPE_STD = 0.5, 1.0  # of differences of the log rate, an octave of altitude apart
_SCALE_CURVE_STD, _SCALE_SLOPE_STD = 0.3, 0.3  # and of the log of the mean score
_SHAPE_STD = 0.3  # of the log of the scores' shape
_GROUND_STD = 1.2  # prior of the log factors of a surface and of trees


@dataclass(frozen=True, slots=True)
class ScoreCurve:
    """One kind in one pose reported as one class, look by look."""

    mean: F64  # (G,)
    log_spread: F64  # (3,)
    shifts: F64  # (S,) of the mean: FACTORS, the lens, then SURFACES
    lapse_logit: F64  # (3,) in the open
    among_logit: float  # added to that among trees

    @property
    def spread(self) -> F64:
        """(G,) over the grid, as are ``lapse`` and ``lapse_among``."""
        return np.asarray(np.exp(np.interp(np.log(GRID_PX), np.log(_SPREAD_KNOTS_PX), self.log_spread)))

    @property
    def lapse(self) -> F64:
        return self._lapse(0.0)

    @property
    def lapse_among(self) -> F64:
        return self._lapse(self.among_logit)

    def _lapse(self, more: float) -> F64:
        logit = np.interp(np.log(GRID_PX), np.log(_LAPSE_KNOTS_PX), self.lapse_logit)
        return np.asarray(expit(logit + more))

    def at(self, pixels: F64, factors: F64) -> tuple[F64, F64, F64]:
        """Mean and spread of the scores, and the lapse, of looks with (N,) pixels and (N, S) factors."""
        x, grid = np.log(pixels), np.log(GRID_PX)
        tables = self.mean, self.spread, self.lapse, self.lapse_among
        mean, spread, in_the_open, among = (np.interp(x, grid, table) for table in tables)
        return mean + factors @ self.shifts, spread, np.where(is_among(factors), among, in_the_open)

    def chance(self, pixels: F64, factors: F64, confidence: float) -> F64:
        """(N,) chance of a report with at least this confidence."""
        mean, spread, lapse = self.at(pixels, factors)
        return np.asarray((1.0 - lapse) * ndtr((mean - score_of(confidence)) / spread))


def is_among(factors: F64) -> NDArray[np.bool_]:
    """(N,) whether trees stand beside what the looks with (N, S) factors show, shade it or hide it."""
    return np.asarray((factors[..., _OF_TREES] > 0.0).any(axis=-1))


Priors = tuple[F64, F64]  # log_spread and shifts of a ScoreCurve, means over all kinds
FIRST_PRIORS: Priors = np.full(3, np.log(_USUAL_SPREAD)), _SHIFT_MEAN
Key = tuple[int, int]  # index in SUBJECTS, index in CLASSES


def factors_of(looks: ScoredLooks) -> F64:
    """(N, S): FACTORS, octaves of the lens, then 1 for the ground among SURFACES.

    Colours that were not measured are set to the mean of the kind on this ground.
    """
    colour = looks.colour.copy()
    for subject, surface in {*zip(looks.subject.tolist(), looks.surface.tolist(), strict=True)}:
        rows = (looks.subject == subject) & (looks.surface == surface)
        known = colour[rows & np.isfinite(colour)]
        colour[rows & np.isnan(colour)] = known.mean() if len(known) else CONTRAST_USUAL
    contrast = np.clip((colour - CONTRAST_USUAL) / CONTRAST_UNIT, *CONTRAST_LIMITS)
    seen = (looks.view, looks.front, looks.pixels, looks.hidden, looks.cut, looks.edge_y > 0.0, looks.beside)
    rows = zip(*seen, looks.shade, looks.blur_px, contrast, looks.others, strict=True)
    factors = np.array([factors_of_look(*look) for look in rows]).reshape(-1, len(FACTORS))
    return np.hstack([factors, looks.lens_octaves[:, None], np.eye(len(SURFACES))[looks.surface]])


def fit_curves(looks: ScoredLooks, factors: F64) -> dict[Key, ScoreCurve]:
    """The curve of each kind and pose for each class that it is reported as.

    Looks through other lenses than the calibrated one decide what the lens does, and nothing else.
    """
    lens = looks.lens_octaves
    keys = [
        (subject, c)
        for subject in range(len(SUBJECTS))
        for c in range(len(CLASSES))
        if _is_reported(looks.where((looks.subject == subject) & (looks.confidences[:, c] > 0)), c)
    ]
    priors, curves = FIRST_PRIORS, dict[Key, ScoreCurve]()
    for _ in range(2):
        for subject, c in keys:
            mine = looks.subject == subject
            usual, other = mine & (lens == 0.0), mine & (lens != 0.0)
            curve = fit_curve(looks.pixels[usual], factors[usual], looks.confidences[usual, c], priors)
            seen_so = looks.pixels[other], factors[other], looks.confidences[other, c]
            curves[subject, c] = _with_lens(curve, *seen_so, priors)
        if keys:
            n = [((looks.subject == s) & (looks.confidences[:, c] > 0)).sum() for s, c in keys]
            weights = np.minimum(n, 300.0)
            priors = (
                np.average([curves[k].log_spread for k in keys], axis=0, weights=weights),
                np.average([curves[k].shifts for k in keys], axis=0, weights=weights),
            )
    return curves


def _is_reported(reports: ScoredLooks, c: int) -> bool:
    strong = reports.confidences[:, c] >= MISSION_CONFIDENCE_MIN
    return bool(strong.sum() >= MIN_REPORTS and len(np.unique(reports.instance[strong])) >= MIN_OBJECTS)


def fit_curve(pixels: F64, factors: F64, confidences: F64, priors: Priors = FIRST_PRIORS) -> ScoreCurve:
    """The curve that makes looks (N,) and priors most likely together. Confidence 0 is no report."""
    seen = confidences > 0
    x = score_of(confidences[seen])
    nodes = _hats(pixels, GRID_PX)
    design = np.hstack([nodes, factors])
    spread_design = nodes @ _hats(GRID_PX, _SPREAD_KNOTS_PX)
    lapse_design = np.column_stack([nodes @ _hats(GRID_PX, _LAPSE_KNOTS_PX), is_among(factors)])
    bends = _smoothness(_N, _CURVE_STD, _SLOPE_STD)
    mean_places = [*range(_N), *range(_FIRST_SHIFT, _LAPSE_AT)]
    usual_log_spread, usual_shifts = priors
    prior: list[tuple[slice, F64 | float, F64 | float]] = [
        (slice(0, _N), *_MEAN),
        (slice(_N, _FIRST_SHIFT), usual_log_spread, _SPREAD_STD),
        (slice(_FIRST_SHIFT, _LAPSE_AT), usual_shifts, _SHIFT_STD),
        (slice(_LAPSE_AT, _AMONG_AT), *_LAPSE),
        (slice(_AMONG_AT, None), *_AMONG),
    ]

    def cost(theta: F64) -> tuple[float, F64]:
        mean, log_std = design @ theta[mean_places], spread_design @ theta[_N:_FIRST_SHIFT]
        std, lapse = np.exp(log_std), expit(lapse_design @ theta[_LAPSE_AT:])
        r = (x - mean[seen]) / std[seen]
        c = (FLOOR_SCORE - mean[~seen]) / std[~seen]
        below = ndtr(c)
        missed = lapse[~seen] + (1.0 - lapse[~seen]) * below
        slope = (1.0 - lapse[~seen]) * np.exp(-0.5 * c * c) / np.sqrt(2 * np.pi) / missed
        value = (log_std[seen] + 0.5 * r * r).sum() - np.log1p(-lapse[seen]).sum() - np.log(missed).sum()
        by_mean, by_log_std = np.empty(len(mean)), np.empty(len(mean))
        by_mean[seen], by_log_std[seen] = -r / std[seen], 1.0 - r * r
        by_mean[~seen], by_log_std[~seen] = slope / std[~seen], slope * c
        gradient = np.zeros(len(theta))
        gradient[mean_places] = design.T @ by_mean
        gradient[_N:_FIRST_SHIFT] = spread_design.T @ by_log_std
        by_lapse = lapse.copy()
        by_lapse[~seen] *= -(1.0 - lapse[~seen]) * (1.0 - below) / missed
        gradient[_LAPSE_AT:] = lapse_design.T @ by_lapse
        value, gradient = _LOOK_WEIGHT * value, _LOOK_WEIGHT * gradient
        bend = bends @ theta[:_N]
        value += 0.5 * bend @ bend
        gradient[:_N] += bends.T @ bend
        for place, centre, std_ in prior:
            off = (theta[place] - centre) / std_
            value += 0.5 * float(np.sum(off * off))
            gradient[place] += off / std_
        return float(value), gradient

    start = np.full(_AMONG_AT + 1, _LAPSE[0])
    start[_AMONG_AT] = _AMONG[0]
    start[:_N] = x.mean() if len(x) else FLOOR_SCORE
    start[_N:_FIRST_SHIFT], start[_FIRST_SHIFT:_LAPSE_AT] = priors
    best = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=_LIMITS, options={"maxiter": 400}).x
    mean, shifts = best[:_N], best[_FIRST_SHIFT:_LAPSE_AT]
    grounds = np.s_[_N_FACTORS + 1 :]
    usual = factors[:, grounds].mean(axis=0) @ shifts[grounds]
    mean += usual
    shifts[grounds] -= usual
    lapse_logit, among_logit = best[_LAPSE_AT:_AMONG_AT], float(best[_AMONG_AT])
    return ScoreCurve(mean, best[_N:_FIRST_SHIFT], shifts, lapse_logit, among_logit)


def _with_lens(curve: ScoreCurve, pixels: F64, factors: F64, confidences: F64, priors: Priors) -> ScoreCurve:
    """The curve with the shift for an octave of the focal length that makes looks (N,) most likely."""
    seen = confidences > 0
    score = score_of(np.where(seen, confidences, 0.5))
    mean, spread, lapse = curve.at(pixels, factors)
    octaves, usual = factors[:, _N_FACTORS], priors[1][_N_FACTORS]
    mean = mean - octaves * curve.shifts[_N_FACTORS]

    def cost(shift: float) -> float:
        middle = mean + octaves * shift
        reported = -0.5 * ((score - middle) / spread) ** 2 - np.log(spread) + np.log1p(-lapse)
        missed = np.log(lapse + (1.0 - lapse) * ndtr((FLOOR_SCORE - middle) / spread))
        likely = float(np.where(seen, reported, missed).sum())
        return 0.5 * ((shift - float(usual)) / _LENS[1]) ** 2 - _LOOK_WEIGHT * likely

    shifts = curve.shifts.copy()
    shifts[_N_FACTORS] = minimize_scalar(cost, bounds=(-1.0, 1.0), method="bounded").x
    return replace(curve, shifts=shifts)


def _hats(x: Sequence[float] | F64, grid: Sequence[float]) -> F64:
    """(N, G) weights of linear interpolation between the nodes of a grid, both on a log scale."""
    return np.stack([np.interp(np.log(x), np.log(grid), unit) for unit in np.eye(len(grid))], axis=1)


def _smoothness(nodes: int, curve_std: float, slope_std: float) -> F64:
    """Rows that turn values at nodes into bends and slopes, in standard deviations."""
    slopes = np.diff(np.eye(nodes), axis=0)
    return np.vstack([np.diff(slopes, axis=0) / curve_std, slopes / slope_std])


# ---- the rest of the model ---------------------------------------------------------------------------


def shifts_of(kind: KindModel) -> F64:
    """(S,) in the order of ``ScoreCurve.shifts``."""
    return np.array([*kind.factors, kind.lens, *(kind.grounds.get(surface, 0.0) for surface in SURFACES)])


def contrast_models(looks: ScoredLooks) -> list[ContrastModel]:
    """Mean and spread over the objects of each kind, for each ground that they stood on."""
    _, first = np.unique(looks.instance, return_index=True)
    models = []
    for subject, (kind, pose) in enumerate(SUBJECTS):
        surfaces = {}
        for k, surface in enumerate(SURFACES):
            colour = looks.colour[first[(looks.subject[first] == subject) & (looks.surface[first] == k)]]
            colour = colour[np.isfinite(colour)]
            if len(colour) >= 3:
                surfaces[surface] = (round(float(colour.mean()), 1), round(float(colour.std()), 1))
        if surfaces:
            models.append(ContrastModel(kind=kind, pose=pose, surfaces=surfaces))
    return models


def fit_box(looks: ScoredLooks) -> BoxModel:
    """Error of a box's centre, from objects reported as what they are.

    The median absolute deviation keeps boxes on something else nearby from counting.
    """
    variances, sizes, blurs = [], [], []
    for low, high in pairwise(GRID_PX):
        for slow, usual, fast in ((0.0, 0.3, 0.7), (0.7, 1.2, 2.0), (2.0, 3.5, 99.0)):
            errors = []
            for index, (kind, pose) in enumerate(SUBJECTS):
                if kind in CLASSES and pose != "standing":
                    rows = (looks.subject == index) & (looks.pixels >= low) & (looks.pixels < high)
                    rows &= (looks.blur_px >= slow) & (looks.blur_px < fast)
                    rows &= (looks.hidden == 0) & (looks.cut == 0)
                    errors.append(looks.offsets_px[rows, CLASSES.index(kind)].ravel())
            found = np.concatenate(errors)
            found = found[np.isfinite(found)]
            if len(found) >= 20:
                variances.append((1.4826 * np.median(np.abs(found - np.median(found)))) ** 2)
                sizes.append(np.sqrt(low * high))
                blurs.append(usual)
    if len(variances) < 6:
        return BoxModel(pixels=0.7, of_object=0.03, of_blur=0.0)
    design = np.column_stack([np.ones(len(sizes)), np.square(sizes), np.square(blurs)])
    squares, _ = nnls(design / np.array(variances)[:, None], np.ones(len(sizes)))
    px, of_object, of_blur = (round(float(v), 4) for v in np.sqrt(squares))
    return BoxModel(pixels=px, of_object=of_object, of_blur=of_blur)


def fit_background(seen: Background, class_index: int) -> BackgroundModel | None:
    """Reports of one class on no object, from the lowest altitude up; None where there are too few.

    The rates per hectare and per tree are Poisson, smoothed and log-linear over log altitude. A factor for
    the surface multiplies the first; it is drawn towards 1 where little was seen. Of a tree that an edge of
    the picture cuts, reports that the edge cuts have a rate of their own. Scores over the floor
    follow a Weibull distribution, whose mean is log-linear over log altitude too. Repeated reports in one
    world count as one finding: all likelihoods are divided by the mean number of reports of the worlds that
    have any (quasi-likelihood: Wedderburn, Biometrika 61, 1974).
    """
    high = seen.altitude_agl_m >= ALTITUDES_M[0]
    mine = (seen.class_index == class_index) & high[seen.picture_of_report]
    found = seen.confidences[mine]
    if len(found) < MIN_REPORTS:
        return None
    pictures = seen.picture_of_report[mine]
    alike = len(found) / len(np.unique(seen.world[pictures]))
    altitude, of_tree = _hats(seen.altitude_agl_m, ALTITUDES_M), seen.of_tree[mine]
    surfaces, none = np.eye(len(SURFACES))[seen.surface], np.zeros((len(high), 0))
    hectares, trees = np.where(high, seen.hectares, 0.0), np.where(high, seen.trees, 0.0)
    rates, factors = _rates(hectares, altitude, surfaces, pictures[~of_tree], seen.world)
    per_tree = per_cut_tree = np.zeros(len(ALTITUDES_M))
    cut_trees, is_cut = np.where(high, seen.cut_trees, 0.0), seen.is_cut[mine]
    if trees.any():
        per_tree, _ = _rates(trees, altitude, none, pictures[of_tree & ~is_cut], seen.world)
    if cut_trees.any():
        per_cut_tree, _ = _rates(cut_trees, altitude, none, pictures[of_tree & is_cut], seen.world)
    followed = mine & np.isfinite(seen.again)
    again = seen.again[followed]
    repeats = again > 0
    over = score_of(found) - FLOOR_SCORE
    hats = altitude[pictures]
    scales = _scales(hats, over, alike)
    above = np.column_stack([seen.confidences[followed][repeats], again[repeats]])
    excess = score_of(np.minimum(above, 0.999)) - FLOOR_SCORE
    same = np.atleast_2d(np.corrcoef(excess.T))[0, -1] * len(excess) if len(excess) >= 3 else 0.0
    return BackgroundModel(
        reported_as=CLASSES[class_index],
        altitude_agl_m=list(ALTITUDES_M),
        per_hectare=[float(f"{r:.3g}") for r in rates],
        surfaces={name: float(f"{f:.3g}") for name, f in zip(SURFACES, factors, strict=True)},
        per_tree=[float(f"{r:.3g}") for r in per_tree],
        per_cut_tree=[float(f"{r:.3g}") for r in per_cut_tree],
        score_scale=scales.round(3).tolist(),
        score_shape=round(_shape(over / (hats @ scales), alike), 3),
        again=round(float((repeats.sum() + 1.0) / (len(again) + 2.0)), 3),
        same_share=round(float(np.clip((same + 0.5 * 5) / (len(excess) + 5), 0.0, 1.0)), 3),
        pixels=round(float(np.median(seen.pixels[mine])), 1),
    )


def _rates(exposure: F64, hats: F64, groups: F64, reported: I64, world: I64) -> tuple[F64, F64]:
    """Rates at the altitudes, and the factor of each group, of reports in the pictures (K,) ``reported``.

    ``exposure`` (M,) is what may be reported in each picture; ``hats`` (M, A), ``groups`` (M, G) and
    ``world`` (M,) say at what altitude, of which group and where it is.
    """
    design, n = np.hstack([hats, groups]), hats.shape[1]
    alike = len(reported) / max(len(np.unique(world[reported])), 1) or 1.0
    at, bends = design[reported].sum(axis=0), _smoothness(n, _RATE_CURVE_STD, _RATE_SLOPE_STD)

    def cost(logs: F64) -> tuple[float, F64]:
        bend, factors = bends @ logs[:n], logs[n:] / _GROUND_STD
        expected = exposure * np.exp(design @ logs)
        value = float((expected.sum() - at @ logs) / alike + 0.5 * (bend @ bend + factors @ factors))
        slope = (design.T @ expected - at) / alike
        return value, slope + np.concatenate([bends.T @ bend, factors / _GROUND_STD])

    start = np.zeros(design.shape[1])
    start[:n] = np.log(max(len(reported), 0.5) / exposure.sum())
    logs = minimize(cost, start, method="L-BFGS-B", jac=True).x
    return np.exp(logs[:n]), np.exp(logs[n:])


def _scales(hats: F64, over: F64, alike: float) -> F64:
    """Means of values (K,) at the altitudes, given their rows of weights (K, A) (quasi-likelihood)."""
    bends = _smoothness(len(ALTITUDES_M), _SCALE_CURVE_STD, _SCALE_SLOPE_STD)

    def cost(logs: F64) -> tuple[float, F64]:
        bend, share = bends @ logs, over * np.exp(-hats @ logs)
        value = float((share + hats @ logs).sum() / alike + 0.5 * bend @ bend)
        return value, hats.T @ (1.0 - share) / alike + bends.T @ bend

    start = np.full(hats.shape[1], np.log(max(over.mean(), 1e-3)))
    return np.asarray(np.exp(minimize(cost, start, method="L-BFGS-B", jac=True).x))


def _shape(ratios: F64, alike: float) -> float:
    """Shape of the Weibull distribution of values (K,) whose mean is 1, drawn towards the exponential's."""
    ratios = np.maximum(ratios, 1e-3)
    shapes, costs = np.linspace(0.5, 2.5, 81), []
    for k in shapes:
        likelihood = weibull_min.logpdf(ratios, k, scale=1.0 / gamma(1.0 + 1.0 / k)).sum()
        costs.append(-likelihood / alike + 0.5 * (np.log(k) / _SHAPE_STD) ** 2)
    return float(shapes[np.argmin(costs)])
