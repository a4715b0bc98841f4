"""What looks at one object have in common: parts of their score's variance, and of their lapses.

One part is the object's own; another its aspect's, which fades as the line of sight turns and as the object
grows in the picture. They are estimated from the likelihood of pairs of looks (composite likelihood: Varin,
Reid and Firth, Statistica Sinica 21, 2011). Two looks share one draw for a part of their lapses: below the
smaller of these parts both lapse, between the two only the look with the larger.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtr

from skysweep.experiments.calibration.fit import FLOOR_SCORE, Key, ScoreCurve
from skysweep.experiments.calibration.looks import CLASSES, SUBJECTS, SURFACES, ScoredLooks
from skysweep.sensing.statistical.factors import FACTORS, NAMES
from skysweep.sensing.statistical.luck import kept
from skysweep.sensing.statistical.model import KindModel, score_of
from skysweep.types import F64

_PAIR_REACH = 16  # looks at an object that are further apart in the list are not paired
_PAIR_WEIGHT = 0.2
_MAX_PAIRS = 4000
_CORRELATIONS = np.linspace(0.0, 0.95, 20)
_LAPSES_SHARED = np.linspace(0.0, 1.0, 11)
_USUALLY_SHARED = 0.6  # of the lapses, while the shares of scores are not known
_SHARES = np.linspace(0.0, 0.9, 19)
_FADES_RAD = np.array([0.1, 0.17, 0.3, 0.5, 0.85, 1.5, 2.6])
_FADES_OF_SCALE = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)


class _Axis(NamedTuple):
    """One of the numbers that are sought: where, and its prior."""

    nodes: F64
    usual: float
    std: float


_OF_SCORES = (  # of objects, of aspects, and the log of the turn over which those fade
    _Axis(_SHARES, 0.3, 0.15),
    _Axis(_SHARES, 0.5, 0.15),
    _Axis(np.log(_FADES_RAD), np.log(0.7), 0.7),
)
_OF_LAPSES = _Axis(_LAPSES_SHARED, 0.5, 0.25), _Axis(_LAPSES_SHARED, 0.3, 0.25)  # of objects, of aspects
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, slots=True)
class Pairs:
    """Pairs of looks at one object: standardised scores, or the floor where not ``seen``."""

    first: F64
    second: F64
    first_seen: NDArray[np.bool_]
    second_seen: NDArray[np.bool_]
    turned_rad: F64  # of the line of sight from the first to the second
    grown: F64  # of the log of the pixels
    first_lapse: F64
    second_lapse: F64

    def log_likelihoods(self, correlation: F64 | float, lapse_share: F64 | float) -> F64:
        """(N,) of the pairs, given their correlations and shared lapses: (N,) or one for all."""
        rho = np.broadcast_to(correlation, self.first.shape)
        shared = lapse_share * np.stack([self.first_lapse, self.second_lapse])
        alone = (np.stack([self.first_lapse, self.second_lapse]) - shared) / (1.0 - shared)
        clear, rest = 1.0 - shared.max(axis=0), np.sqrt(1.0 - rho**2)
        found = np.empty(len(rho))
        both = self.first_seen & self.second_seen
        a, b = self.first[both], self.second[both]
        q = (a * a - 2 * rho[both] * a * b + b * b) / rest[both] ** 2
        seen = clear[both] * (1.0 - alone[:, both]).prod(axis=0)
        found[both] = -0.5 * q - np.log(rest[both]) + np.log(seen)
        for i, j, x, y, only in (
            (0, 1, self.first, self.second, self.first_seen & ~self.second_seen),
            (1, 0, self.second, self.first, self.second_seen & ~self.first_seen),
        ):
            below = ndtr((y[only] - rho[only] * x[only]) / rest[only])
            missed = alone[j, only] + (1 - alone[j, only]) * below
            missed = np.maximum(shared[j, only] - shared[i, only], 0.0) + clear[only] * missed
            missed *= 1.0 - alone[i, only]
            found[only] = -0.5 * x[only] ** 2 + np.log(np.maximum(missed, 1e-300))
        none = ~self.first_seen & ~self.second_seen
        a, b, (p, q) = self.first[none], self.second[none], alone[:, none]
        together = (1 - p) * (1 - q) * both_below(a, b, rho[none])
        missed = p * q + p * (1 - q) * ndtr(b) + q * (1 - p) * ndtr(a) + together
        first_lapses = shared[0, none] > shared[1, none]
        other = np.where(first_lapses, q + (1 - q) * ndtr(b), p + (1 - p) * ndtr(a))
        missed = shared[:, none].min(axis=0) + np.ptp(shared[:, none], axis=0) * other + clear[none] * missed
        found[none] = np.log(np.maximum(missed, 1e-300))
        return found


def both_below(a: F64, b: F64, correlation: F64) -> F64:
    """Chance that two normals with this correlation are below a and b (Drezner and Wesolowsky, 1990)."""
    t = correlation[:, None] * (_NODES + 1) / 2
    rest = 1.0 - t * t
    a_, b_ = a[:, None], b[:, None]
    density = np.exp(-(a_ * a_ - 2 * t * a_ * b_ + b_ * b_) / (2 * rest)) / np.sqrt(rest)
    return np.asarray(np.exp(log_ndtr(a) + log_ndtr(b)) + correlation / (4 * np.pi) * (density @ _WEIGHTS))


def pairs_of(looks: ScoredLooks, factors: F64, curve: ScoreCurve, c: int) -> Pairs:
    """Pairs of looks at one object."""
    mean, spread, lapse = curve.at(looks.pixels, factors)
    seen = looks.confidences[:, c] > 0
    score = np.where(seen, score_of(np.where(seen, looks.confidences[:, c], 0.5)), FLOOR_SCORE)
    z = np.clip((score - mean) / spread, -4.0, 6.0)
    order = np.lexsort((looks.picture, looks.instance))
    instance, found = looks.instance[order], []
    for lag in range(1, _PAIR_REACH):
        same = instance[lag:] == instance[:-lag]
        found.append(np.column_stack([order[:-lag], order[lag:]])[same])
    rows = np.concatenate(found)
    rows = rows[:: -(-len(rows) // _MAX_PAIRS) or 1]
    i, j = rows[:, 0], rows[:, 1]
    turned_rad = np.linalg.norm(looks.sight[i] - looks.sight[j], axis=1)
    grown = np.log(looks.pixels[i] / looks.pixels[j])
    return Pairs(z[i], z[j], seen[i], seen[j], turned_rad, grown, lapse[i], lapse[j])


class Shares(NamedTuple):
    """Those of one kind, and the turn of the line of sight that leaves 1/e of an aspect's."""

    of_object: float
    of_aspect: float
    fade_rad: float
    lapse_of_object: float
    lapse_of_aspect: float


def fit_shares(
    looks: ScoredLooks, factors: F64, curves: dict[Key, ScoreCurve]
) -> tuple[dict[Key, Shares], float]:
    """The shares of each kind, and the growth, a log, over which those of aspects fade.

    First come those of the scores, then those of the lapses. Each kind's are drawn towards the best for all.
    Where an aspect fades the lapses in common are right to first order: rare lapses.
    """
    pairs = {
        (s, c): pairs_of(looks.where(looks.subject == s), factors[looks.subject == s], curve, c)
        for (s, c), curve in curves.items()
    }
    known = {
        k: np.stack([p.log_likelihoods(r, _USUALLY_SHARED) for r in _CORRELATIONS]) for k, p in pairs.items()
    }
    best, best_value, fade_scale = dict[Key, tuple[float, ...]](), -np.inf, _FADES_OF_SCALE[0]
    for scale in _FADES_OF_SCALE:
        tables = {k: _of_scores(p, known[k], scale) for k, p in pairs.items()}
        value = sum(float(table.max()) for table in tables.values())
        if value > best_value:
            best, best_value, fade_scale = _pooled(tables, _OF_SCORES), value, scale
    lapses = _pooled({k: _of_lapses(p, best[k], fade_scale) for k, p in pairs.items()}, _OF_LAPSES)
    return {
        k: Shares(own, min(aspect, 0.95 - own), float(np.exp(log_rad)), ever, min(there, 1.0 - ever))
        for k, (own, aspect, log_rad) in best.items()
        for ever, there in [lapses[k]]
    }, fade_scale


def _of_scores(pairs: Pairs, known: F64, fade_scale: float) -> F64:
    """Log-likelihoods over _OF_SCORES; ``known`` (R, N) are those of the pairs over _CORRELATIONS."""
    table = np.empty((len(_SHARES), len(_SHARES), len(_FADES_RAD)))
    for f, fade_rad in enumerate(_FADES_RAD.tolist()):
        left = kept(pairs.turned_rad, pairs.grown, fade_rad, fade_scale)
        for o, own in enumerate(_SHARES.tolist()):
            for a, aspect in enumerate(_SHARES.tolist()):
                correlation = np.minimum(own + min(aspect, 0.95 - own) * left, 0.95)
                table[o, a, f] = _between(_CORRELATIONS, known, correlation).sum()
    return table


def _of_lapses(pairs: Pairs, of_scores: tuple[float, ...], fade_scale: float) -> F64:
    """Log-likelihoods over _OF_LAPSES, with what is sought _OF_SCORES known."""
    own, aspect, log_rad = of_scores
    left = kept(pairs.turned_rad, pairs.grown, float(np.exp(log_rad)), fade_scale)
    correlation = np.minimum(own + min(aspect, 0.95 - own) * left, 0.95)
    known = np.stack([pairs.log_likelihoods(correlation, s) for s in _LAPSES_SHARED])
    return np.array(
        [
            [
                _between(_LAPSES_SHARED, known, ever + min(there, 1.0 - ever) * left).sum()
                for there in _LAPSES_SHARED
            ]
            for ever in _LAPSES_SHARED
        ]
    )


def _between(nodes: F64, values: F64, at: F64) -> F64:
    """(N,) of the columns of ``values`` (R, N), each where it is ``at`` among equally spaced nodes (R,)."""
    place = at / (nodes[1] - nodes[0])
    k = np.minimum(place.astype(int), len(nodes) - 2)
    columns, w = np.arange(len(at)), place - k
    return np.asarray((1.0 - w) * values[k, columns] + w * values[k + 1, columns])


def _pooled(tables: dict[Key, F64], axes: tuple[_Axis, ...]) -> dict[Key, tuple[float, ...]]:
    """The best nodes of each kind's table, drawn towards the best for all."""
    if not tables:
        return {}
    centre = _best(np.sum([*tables.values()], axis=0), axes, [axis.usual for axis in axes])
    return {k: _best(table, axes, centre) for k, table in tables.items()}


def _best(table: F64, axes: tuple[_Axis, ...], centre: Sequence[float]) -> tuple[float, ...]:
    """The nodes of a table of log-likelihoods that are most likely with their prior."""
    off = np.meshgrid(
        *((axis.nodes - c) / axis.std for axis, c in zip(axes, centre, strict=True)), indexing="ij"
    )
    prior = sum((o**2 for o in off), np.zeros(table.shape))
    place = np.unravel_index(np.argmax(_PAIR_WEIGHT * table - 0.5 * prior), table.shape)
    return tuple(float(axis.nodes[k]) for axis, k in zip(axes, place, strict=True))


def kind_model(key: Key, curve: ScoreCurve, shares: Shares) -> KindModel:
    """One kind as the model's file holds it."""
    kind, pose = SUBJECTS[key[0]]
    shifts = curve.shifts.round(3).tolist()
    return KindModel(
        kind=kind,
        pose=pose,
        reported_as=CLASSES[key[1]],
        score=curve.mean.round(3).tolist(),
        spread=curve.spread.round(3).tolist(),
        **dict(zip((*NAMES, "lens"), shifts, strict=False)),
        grounds=dict(zip(SURFACES, shifts[len(FACTORS) + 1 :], strict=True)),
        lapse=curve.lapse.round(4).tolist(),
        lapse_among=curve.lapse_among.round(4).tolist(),
        object_share=round(shares.of_object, 3),
        aspect_share=round(shares.of_aspect, 3),
        fade_rad=round(shares.fade_rad, 3),
        lapse_object_share=round(shares.lapse_of_object, 3),
        lapse_aspect_share=round(shares.lapse_of_aspect, 3),
    )
