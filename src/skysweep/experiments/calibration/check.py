"""Goodness of fit of the statistical sensor, on looks that the fit has not seen.

Worlds are dealt into folds, and each fold is predicted from a fit to the others. Looks of one world share
ground, light and objects, so the fit knows nothing of the fold that it predicts. Successive looks are
correlated, so the measured shares are less certain than those of as many independent looks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skysweep.arrays import I64
from skysweep.experiments.calibration.fit import MISSION_CONFIDENCE_MIN, Key, fit_curves
from skysweep.experiments.calibration.looks import CLASSES, SUBJECTS, ScoredLooks
from skysweep.sensing.statistical.factors import CONTRAST_UNIT, CONTRAST_USUAL, NAMES
from skysweep.sensing.statistical.model import Fit, HeldOut
from skysweep.types import F64

FOLDS = 5
THRESHOLDS = (MISSION_CONFIDENCE_MIN, 0.6)  # missions report from the first, and confirm from the second
LEAST = 1e-3  # chance of a report that occurs in no other fold
EDGES: dict[str, tuple[float, ...]] = {
    "pixels": (4, 7, 10, 14, 20, 40, 80, 220),
    "off nadir (deg)": (0, 10, 20, 30, 40, 50),
    "from behind .. ahead": (-1, -0.4, -0.1, 0.1, 0.4, 1),
    "hidden share": (0, 0.01, 0.25, 0.5, 0.75),
    "cut share": (0, 0.01, 0.25, 0.5, 0.75),
    "upper, lower edge (0, 1)": (0, 1, 2),
    "beside a crown (0, 1)": (0, 1, 2),
    "in the shade (share)": (0, 0.01, 0.5, 0.99, 1.01),
    "blur over pixels": (0, 0.05, 0.15, 0.4, 1.0),
    "contrast (CIE76)": (0, 15, 25, 35, 50, 150),
    "others in the picture": (0, 1, 3, 10, 30, 300),
    "focal length (octaves)": (0, 0.01, 1, 2, 3.01),
}


@dataclass(frozen=True, slots=True)
class Told:
    """Looks (M,) at each kind as each class that it is reported as, and their cross-validated predictions."""

    subject: I64
    class_index: I64
    factors: F64  # (M, S)
    values: dict[str, F64]  # of every entry of EDGES
    confidences: F64
    chance: F64  # (M, T) of a report for each threshold
    rate: F64  # (M, T) of all looks at the kind

    def reported(self, t: int) -> NDArray[np.bool_]:
        """(M,) whether the confidence reached threshold number ``t``."""
        return self.confidences >= THRESHOLDS[t]

    @property
    def is_own(self) -> NDArray[np.bool_]:
        """(M,) targets reported as what they are."""
        own = np.array([CLASSES.index(kind) if kind in CLASSES else -1 for kind, _ in SUBJECTS])
        return np.asarray(own[self.subject] == self.class_index)


def tell(looks: ScoredLooks, factors: F64, keys: list[Key]) -> Told:
    """Cross-validated predictions."""
    worlds, world = np.unique(looks.world, return_inverse=True)
    fold = (np.random.default_rng(0).permutation(len(worlds)) % FOLDS)[world]
    no_rows, no_chances = np.zeros(0, dtype=int), np.zeros((0, len(THRESHOLDS)))
    parts = [(no_rows, no_rows, no_chances, no_chances)]  # rows of the looks, classes, chances, rates
    for f in range(FOLDS):
        train, test = np.flatnonzero(fold != f), np.flatnonzero(fold == f)
        if not len(train) or not len(test):
            continue
        known = looks.where(train)
        curves = fit_curves(known, factors[train])
        for subject, c in keys:
            rows = test[looks.subject[test] == subject]
            curve, mine = curves.get((subject, c)), known.subject == subject
            chance = np.full((len(rows), len(THRESHOLDS)), LEAST)
            rate = np.full_like(chance, LEAST)
            for t, threshold in enumerate(THRESHOLDS):
                if curve is not None:
                    chance[:, t] = curve.chance(looks.pixels[rows], factors[rows], threshold)
                if mine.any():
                    rate[:, t] = (known.confidences[mine, c] >= threshold).mean()
            parts.append((rows, np.full(len(rows), c), chance, rate))
    rows, class_index, chance, rate = (np.concatenate(column) for column in zip(*parts, strict=True))
    contrast = factors[rows, NAMES.index("contrast")] * CONTRAST_UNIT + CONTRAST_USUAL
    values = {
        "pixels": looks.pixels[rows],
        "off nadir (deg)": np.degrees(np.arcsin(np.sqrt(looks.view[rows]))),
        "from behind .. ahead": looks.front[rows],
        "hidden share": looks.hidden[rows],
        "cut share": looks.cut[rows],
        "upper, lower edge (0, 1)": looks.edge_y[rows],
        "beside a crown (0, 1)": looks.beside[rows],
        "in the shade (share)": looks.shade[rows],
        "blur over pixels": factors[rows, NAMES.index("blur")],
        "contrast (CIE76)": np.maximum(contrast, 0.0),
        "others in the picture": looks.others[rows],
        "focal length (octaves)": looks.lens_octaves[rows],
    }
    subject, confidences = looks.subject[rows], looks.confidences[rows, class_index]
    chances = (np.clip(part, LEAST, 1 - LEAST) for part in (chance, rate))
    return Told(subject, class_index, factors[rows], values, confidences, *chances)


def goodness(told: Told) -> list[HeldOut]:
    """Scores at each threshold, with those of parts of the looks at the missions' threshold."""
    return [_held_out(told, t) for t in range(len(THRESHOLDS))] if len(told.subject) else []


def _held_out(told: Told, t: int) -> HeldOut:
    y, p, rate = told.reported(t).astype(float), told.chance[:, t], told.rate[:, t]
    left = _deviance(y, rate)
    return HeldOut(
        confidence=THRESHOLDS[t],
        folds=FOLDS,
        brier=round(float(((y - p) ** 2).mean()), 5),
        brier_of_rates=round(float(((y - rate) ** 2).mean()), 5),
        deviance_explained=round(float(1.0 - _deviance(y, p) / left), 3) if left > 0 else 0.0,
        calibration_error=round(calibration_error(y, p), 4),
        parts=_parts(told) if t == 0 else [],
    )


def _deviance(y: F64, p: F64) -> float:
    return float(-2.0 * (y * np.log(p) + (1.0 - y) * np.log1p(-p)).sum())


def calibration_error(y: F64, p: F64, bins: int = 10) -> float:
    """Mean distance between measured share and mean chance over bins of equal width, weighted by looks."""
    which = np.minimum((p * bins).astype(int), bins - 1)
    gaps = np.abs(np.bincount(which, y - p, minlength=bins))
    return float(gaps.sum() / len(y))


def _parts(told: Told) -> list[Fit]:
    y, p, own = told.reported(0), told.chance[:, 0], told.is_own
    parts = []
    for name, edges in EDGES.items():
        for low, high in pairwise(edges):
            inside = own & (told.values[name] >= low) & (told.values[name] < high)
            parts += _part(f"targets, {name} {low:g}..{high:g}", inside, y, p)
    for subject, c in sorted({*zip(told.subject.tolist(), told.class_index.tolist(), strict=True)}):
        kind, pose = SUBJECTS[subject]
        inside = (told.subject == subject) & (told.class_index == c)
        parts += _part(f"{kind}, {pose}, as {CLASSES[c]}", inside, y, p)
    return parts


def _part(name: str, inside: NDArray[np.bool_], y: NDArray[np.bool_], p: F64) -> list[Fit]:
    if not inside.any():
        return []
    measured, drawn = float(y[inside].mean()), float(p[inside].mean())
    return [Fit(part=name, looks=int(inside.sum()), measured=round(measured, 4), drawn=round(drawn, 4))]
