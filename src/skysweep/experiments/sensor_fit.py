"""From looks to the tables of the statistical sensor.

What is fitted is what the sensor draws: with probability p the detector responds, with a confidence whose
logit is normal, and the response is reported when it reaches the threshold. Both depend on pixels on target;
each node of the grid is fitted by maximum likelihood to the looks around it, weighted by a triangle over
log pixels (local likelihood: Loader, Local Regression and Likelihood, 1999). Looks without a report are
censored at the floor of the experiment, so the tables hold for every threshold above it.

Objects differ: one offset for each object, normal in logits, moves its probability and its confidences in
all looks. Its variance is the mean product of the scores of two looks at one object over the product of
their information, which is the moment estimate of a generalised linear mixed model (Breslow and Clayton,
J. Am. Stat. Assoc. 88, 1993).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, nnls
from scipy.special import expit, logit
from scipy.stats import norm

from skysweep.experiments.sensor_looks import CLASSES, CONFIDENCE_FLOOR, SUBJECTS, Empties, Looks
from skysweep.sensing.statistical import BackgroundModel, KindModel, StatisticalModel

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

GRID_PX = (5.0, 7.0, 9.0, 11.0, 14.0, 18.0, 24.0, 34.0, 50.0, 80.0, 130.0, 200.0)
ALTITUDES_M = (3.0, 6.0, 12.0, 25.0, 50.0, 100.0)
MISSION_CONFIDENCE_MIN = 0.25
RARE = 0.005  # pairs of kind and class that are seen less than this at every size are left out

_FLOOR_LOGIT = float(logit(CONFIDENCE_FLOOR))
_STD_LIMITS = (0.15, 2.5)
_PRIOR_LOOKS = 3.0  # how many looks the prior is worth
_PRIOR_MEAN_STD = 1.5
_PRIOR_LOG_STD_STD = 0.5
_USUAL_STD = 0.8
_OFFSET_STD_MAX = 2.0
_N_OFFSETS = 200


@dataclass(frozen=True, slots=True)
class Curve:
    """One kind in one pose reported as one class, before its objects are told apart."""

    probability: F64  # (G,)
    mean: F64  # (G,) of the confidence logit
    std: F64  # (G,)

    def at(self, pixels: F64) -> tuple[F64, F64, F64]:
        """The three values at ``pixels`` (N,), linear in log pixels between the nodes."""
        x, grid = np.log(pixels), np.log(GRID_PX)
        return (
            np.interp(x, grid, self.probability),
            np.interp(x, grid, self.mean),
            np.interp(x, grid, self.std),
        )


def fit_sensor(looks: Looks, empties: Empties, detector: str, pictures: int, seed: int) -> StatisticalModel:
    """The model that the looks support."""
    kinds = []
    for index, (kind, pose) in enumerate(SUBJECTS):
        rows = looks.subject == index
        for c, name in enumerate(CLASSES):
            confidences = looks.confidences[rows, c]
            if rows.any() and _is_reported(looks.pixels[rows], confidences):
                curve = fit_curve(looks.pixels[rows], confidences)
                kinds.append(_kind_model(kind, pose, name, curve, looks, rows, c))
    fraction, px = fit_centres(looks)
    return StatisticalModel(
        detector=detector,
        pictures=pictures,
        seed=seed,
        pixels=list(GRID_PX),
        kinds=kinds,
        background=[b for c in range(len(CLASSES)) if (b := fit_background(empties, c)) is not None],
        centre_std_fraction=round(fraction, 4),
        centre_std_px=round(px, 3),
    )


def node_weights(pixels: F64) -> F64:
    """(G, N): how much each look counts for each node; hats over log pixels that sum to 1."""
    x, grid = np.clip(np.log(pixels), np.log(GRID_PX[0]), np.log(GRID_PX[-1])), np.log(GRID_PX)
    return np.stack([np.interp(x, grid, unit) for unit in np.eye(len(grid))])


def fit_curve(pixels: F64, confidences: F64) -> Curve:
    """Probability and confidence logits over the grid from looks (N,); confidence 0 is no report.

    Sizes that no look had take the values of the nearest size that one had; confidences where nothing was
    reported, those of the nearest size where something was. The fit to all sizes is the prior of each.
    """
    weights = node_weights(pixels)
    seen = confidences > 0
    values = np.full((len(GRID_PX), 3), np.nan)
    mean, std = 0.0, _USUAL_STD
    if seen.any():
        guess = float(logit(confidences[seen]).mean()), _USUAL_STD
        _, mean, std = _fit_node(np.ones(len(pixels)), confidences, guess)
    for g, w in enumerate(weights):
        used = w > 0
        if w[seen].sum() > 0:
            values[g] = _fit_node(w[used], confidences[used], (mean, std))
        elif w.sum() >= 1.0:
            values[g, 0] = 0.0
    otherwise = (0.0, mean, std)
    return Curve(*(_nearest_known(column, o) for column, o in zip(values.T, otherwise, strict=True)))


def _nearest_known(values: F64, otherwise: float) -> F64:
    known = np.flatnonzero(np.isfinite(values))
    if not len(known):
        return np.full(len(values), otherwise)
    return values[known[np.abs(np.arange(len(values))[:, None] - known).argmin(axis=1)]]


def _fit_node(
    weights: F64, confidences: F64, prior: tuple[float, float], floor: float = _FLOOR_LOGIT
) -> tuple[float, float, float]:
    """Probability, mean and std that make weighted looks most likely; ``prior``: expected mean and std."""
    seen = confidences > 0
    x, w = logit(confidences[seen]), weights[seen]
    missed = weights[~seen].sum()

    def cost(theta: F64) -> float:
        p, mean, std = expit(theta[0]), theta[1], np.exp(theta[2])
        report = p * norm.sf((floor - mean) / std)
        fit = -(w * (np.log(p) + norm.logpdf(x, mean, std))).sum() - missed * np.log1p(
            -min(report, 1 - 1e-12)
        )
        off = (mean - prior[0]) / _PRIOR_MEAN_STD, (theta[2] - np.log(prior[1])) / _PRIOR_LOG_STD_STD
        return float(fit + _PRIOR_LOOKS / 2 * (off[0] ** 2 + off[1] ** 2))

    rate = np.clip(w.sum() / (w.sum() + missed), 0.02, 0.98)
    start = np.array([logit(rate), np.average(x, weights=w), np.log(prior[1])])
    limits = [(-9.0, 9.0), (floor - 0.5, 6.0), tuple(np.log(_STD_LIMITS))]
    best = minimize(cost, start, method="L-BFGS-B", bounds=limits).x
    return float(expit(best[0])), float(best[1]), float(np.exp(best[2]))


def _is_reported(pixels: F64, confidences: F64) -> bool:
    weights = node_weights(pixels)
    counts = weights.sum(axis=1)
    rates = weights @ (confidences >= MISSION_CONFIDENCE_MIN) / np.maximum(counts, 1e-9)
    return bool((rates[counts >= 1.0] >= RARE).any())


def _kind_model(
    kind: str, pose: str, name: str, curve: Curve, looks: Looks, rows: NDArray[np.bool_], c: int
) -> KindModel:
    std = fit_offset_std(curve, looks.pixels[rows], looks.confidences[rows, c], looks.instance[rows])
    middle = of_middle_object(curve, std)
    return KindModel(
        kind=kind,
        pose=pose,
        reported_as=name,
        probability=_rounded(middle.probability),
        confidence_logit_mean=_rounded(middle.mean),
        confidence_logit_std=_rounded(middle.std),
        object_logit_std=round(std, 3),
    )


def of_middle_object(curve: Curve, offset_std: float) -> Curve:
    """The curve of an object without offset, from that over all objects.

    Objects that are seen well make up more of the reports, so their offsets are taken out of mean and
    spread as well as out of the probability.
    """
    offsets = norm.ppf((np.arange(_N_OFFSETS) + 0.5) / _N_OFFSETS)[:, None] * offset_std
    p = np.clip(curve.probability, 1e-6, 1 - 1e-6)
    c = 16.0 * np.sqrt(3.0) / (15.0 * np.pi)  # Zeger, Liang and Albert, Biometrics 44, 1988
    middle = logit(p) * np.sqrt(1.0 + (c * offset_std) ** 2)
    share = expit(middle + offsets)
    share = share / share.sum(axis=0)
    shift = (share * offsets).sum(axis=0)
    variance = (share * offsets**2).sum(axis=0) - shift**2
    certain = (curve.probability < 1e-5) | (curve.probability > 1 - 1e-5)
    return Curve(
        np.where(certain, np.round(curve.probability), expit(middle)),
        curve.mean - shift,
        np.sqrt(np.maximum(curve.std**2 - variance, (0.5 * curve.std) ** 2)),
    )


def fit_offset_std(curve: Curve, pixels: F64, confidences: F64, instance: I64) -> float:
    """Standard deviation (logits) of what is the object's own in repeated looks at the same objects."""
    p, mean, std = curve.at(pixels)
    p = np.clip(p, 1e-6, 1 - 1e-6)
    a = (_FLOOR_LOGIT - mean) / std
    above = norm.sf(a)
    report = np.clip(p * above, 1e-9, 1 - 1e-9)
    slope = p * (1 - p) * above + p * norm.pdf(a) / std  # of the report's probability
    seen = confidences > 0
    x = logit(np.where(seen, confidences, 0.5))
    score = np.where(seen, (1 - p) + (x - mean) / std**2, -slope / (1 - report))
    hit_score_squared = (
        (1 - p) ** 2 * above + 2 * (1 - p) * norm.pdf(a) / std + (above + a * norm.pdf(a)) / std**2
    )
    information = p * hit_score_squared + slope**2 / (1 - report)
    _, which = np.unique(instance, return_inverse=True)

    def pairs(values: F64) -> float:
        return float((np.bincount(which, values) ** 2 - np.bincount(which, values**2)).sum())

    denominator = pairs(information)
    variance = pairs(score) / denominator if denominator > 0 else 0.0
    return float(np.clip(np.sqrt(max(variance, 0.0)), 0.0, _OFFSET_STD_MAX))


def fit_centres(looks: Looks) -> tuple[float, float]:
    """Error of a box's centre, each axis: (share of the object's pixels, pixels), added in squares.

    From objects reported as what they are. Robust (median absolute deviation), so that a box on something
    else nearby does not count.
    """
    variances, sizes = [], []
    for g in range(len(GRID_PX) - 1):
        errors = []
        for index, (kind, pose) in enumerate(SUBJECTS):
            if kind not in CLASSES or pose == "standing":
                continue
            between = (looks.pixels >= GRID_PX[g]) & (looks.pixels < GRID_PX[g + 1])
            errors.append(looks.offsets_px[(looks.subject == index) & between, CLASSES.index(kind)].ravel())
        found = np.concatenate(errors)
        found = found[np.isfinite(found)]
        if len(found) >= 20:
            variances.append((1.4826 * np.median(np.abs(found - np.median(found)))) ** 2)
            sizes.append(np.sqrt(GRID_PX[g] * GRID_PX[g + 1]))
    if len(variances) < 2:
        return 0.03, 0.7
    relative = np.column_stack([np.ones(len(sizes)), np.square(sizes)]) / np.array(variances)[:, None]
    (px2, fraction2), _ = nnls(relative, np.ones(len(sizes)))
    return float(np.sqrt(fraction2)), float(np.sqrt(px2))


def fit_background(empties: Empties, class_index: int) -> BackgroundModel | None:
    """Detections of one class where nothing is, with the missions' threshold; None when there was none.

    Confidences are those of one censored normal, as for objects; the rate follows the altitude.
    """
    mine = (empties.class_index == class_index) & (empties.confidences >= MISSION_CONFIDENCE_MIN)
    if not mine.any():
        return None
    n, found = len(empties.altitude_agl_m), empties.confidences[mine]
    looks = np.concatenate([found, np.zeros(max(n - len(found), 1))])
    guess = float(logit(found).mean()), _USUAL_STD
    response, mean, std = _fit_node(np.ones(len(looks)), looks, guess, float(logit(MISSION_CONFIDENCE_MIN)))
    grid = np.log(ALTITUDES_M)
    x = np.clip(np.log(empties.altitude_agl_m), grid[0], grid[-1])
    weights = np.stack([np.interp(x, grid, unit) for unit in np.eye(len(grid))])
    rates = weights @ np.bincount(empties.picture[mine], minlength=n) / np.maximum(weights.sum(axis=1), 1e-9)
    per_report = response * len(looks) / len(found)  # responses for each one that reaches the threshold
    return BackgroundModel(
        reported_as=CLASSES[class_index],
        altitude_agl_m=list(ALTITUDES_M),
        rate_per_picture=[round(min(float(r) * per_report, 1.0), 5) for r in rates],
        confidence_logit_mean=round(mean, 3),
        confidence_logit_std=round(std, 3),
        pixels=round(float(np.median(empties.pixels[mine])), 1),
    )


def _rounded(values: F64) -> list[float]:
    return [round(float(v), 4) for v in values]
