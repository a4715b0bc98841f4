"""Goodness of fit of the statistical sensor, on looks that the fit has not seen.

Worlds are dealt into folds; each fold is told by what was fitted to the others. Looks of one world share
ground, light and objects, so nothing of a fold is known to its fit. Successive looks are correlated: the
intervals that one would draw around the measured shares are wider than those of as many independent looks.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skysweep.experiments.calibration.fit import MISSION_CONFIDENCE_MIN, Key, fit_curves
from skysweep.experiments.calibration.looks import CLASSES, SUBJECTS, ScoredLooks
from skysweep.sensing.statistical.factors import CONTRAST_UNIT, CONTRAST_USUAL, NAMES
from skysweep.sensing.statistical.model import Fit, HeldOut
from skysweep.types import F64

I64 = NDArray[np.int64]

FOLDS = 5
THRESHOLDS = (MISSION_CONFIDENCE_MIN, 0.6)  # what missions report, what confirms a candidate
LEAST = 1e-3  # chance of a report of what was not reported in any other fold
EDGES: dict[str, tuple[float, ...]] = {
    "pixels": (4, 7, 10, 14, 20, 40, 80, 220),
    "off nadir (deg)": (0, 10, 20, 30, 40, 50),
    "from behind .. ahead": (-1, -0.4, -0.1, 0.1, 0.4, 1),
    "hidden share": (0, 0.01, 0.25, 0.5, 0.75),
    "cut share": (0, 0.01, 0.25, 0.5, 0.75),
    "upper, lower edge (0, 1)": (0, 1, 2),
    "beside a crown (0, 1)": (0, 1, 2),
    "blur over pixels": (0, 0.05, 0.15, 0.4, 1.0),
    "contrast (CIE76)": (0, 15, 25, 35, 50, 150),
}


@dataclass(frozen=True, slots=True)
class Told:
    """Looks at each kind as each class that it is reported as (M,), and what other folds say of them."""

    subject: I64
    class_index: I64
    factors: F64  # (M, S)
    values: dict[str, F64]  # of every entry of EDGES
    confidences: F64
    chance: F64  # (M, T) of a report for each threshold
    rate: F64  # (M, T) of all looks at the kind

    def reported(self, t: int) -> NDArray[np.bool_]:
        """(M,) what was reported with at least threshold ``t``."""
        return self.confidences >= THRESHOLDS[t]

    @property
    def is_own(self) -> NDArray[np.bool_]:
        """(M,) targets reported as what they are."""
        own = [kind in CLASSES and CLASSES.index(kind) for kind, _ in SUBJECTS]
        of_subject = np.array([-1 if index is False else index for index in own])
        return np.asarray(of_subject[self.subject] == self.class_index)


def tell(looks: ScoredLooks, factors: F64, keys: list[Key]) -> Told:
    """What the folds say of one another."""
    worlds, world = np.unique(looks.world, return_inverse=True)
    fold_of_world = np.random.default_rng(0).permutation(len(worlds)) % FOLDS
    fold = fold_of_world[world]
    parts: list[tuple[F64, ...]] = []
    rows_of: list[I64] = []
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
            parts.append((np.full(len(rows), c), looks.confidences[rows, c], chance, rate))
            rows_of.append(rows)
    rows = np.concatenate([*rows_of, np.zeros(0, dtype=int)])
    contrast = factors[rows, NAMES.index("contrast")] * CONTRAST_UNIT + CONTRAST_USUAL
    values = {
        "pixels": looks.pixels[rows],
        "off nadir (deg)": np.degrees(np.arcsin(np.sqrt(looks.view[rows]))),
        "from behind .. ahead": looks.front[rows],
        "hidden share": looks.hidden[rows],
        "cut share": looks.cut[rows],
        "upper, lower edge (0, 1)": looks.edge_y[rows],
        "beside a crown (0, 1)": looks.beside[rows],
        "blur over pixels": factors[rows, NAMES.index("blur")],
        "contrast (CIE76)": np.maximum(contrast, 0.0),
    }
    empty = np.zeros((0, len(THRESHOLDS)))
    return Told(
        looks.subject[rows],
        np.concatenate([*(p[0] for p in parts), np.zeros(0)]).astype(int),
        factors[rows],
        values,
        np.concatenate([*(p[1] for p in parts), np.zeros(0)]),
        np.clip(np.concatenate([*(p[2] for p in parts), empty]), LEAST, 1 - LEAST),
        np.clip(np.concatenate([*(p[3] for p in parts), empty]), LEAST, 1 - LEAST),
    )


def goodness(told: Told) -> list[HeldOut]:
    """Scores at every threshold; the parts of the looks at the missions' threshold only."""
    if not len(told.subject):
        return []
    return [_held_out(told, t) for t in range(len(THRESHOLDS))]


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
    """Mean distance of the measured share and the mean chance, over bins of equal width, by looks."""
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
