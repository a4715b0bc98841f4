"""What every candidate is believed to be, updated by every look that found or missed it."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from skysweep.arrays import F64
from skysweep.geometry.camera import Lens, project, projected
from skysweep.sensing.statistical.model import score_of
from skysweep.strategies.belief.account import Account, within_clear
from skysweep.strategies.belief.fit import Fit
from skysweep.strategies.belief.hypotheses import Hypotheses
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.strategies.context import MissionContext
from skysweep.types import Candidate, Look, Sighting

_EM_STEPS = 3
_UNSURE_M = 0.7  # of a candidate's place: nearer to an edge of the picture a miss says nothing
_SAME_STD_M = 0.8  # of a place seen in a hard manoeuvre, beside the tracker's covariance
_SAME_FAR_M = 20.0
_OF_ONE = 0.6  # of its length: nearer to each other two boxes of one picture may be of one thing
_PLAIN = ("id", "class_name", "evidence", "n_looks", "in_view", "only_cut")  # of a suspect, kept as they are
_SAME_GATE = 6.0  # 95 % of a chi-squared variable with 2 degrees of freedom


@dataclass(slots=True)
class Suspect:
    """One candidate and what is believed of it: a target, another thing, or nothing at all."""

    id: int
    class_name: str
    belief: F64
    place_enu_m: F64  # (3,)
    likely: tuple[float, float, float] = (0.0, 0.0, 0.0)  # log likelihood of place and looks, in that order
    evidence: float = 0.0  # log likelihood ratio of all looks: a target against anything else
    shift: tuple[float, float] = (0.0, 0.0)  # what it says of the shift, if it is a target: sum and weight
    n_looks: int = 0  # that told something of it
    lowest_m: float = math.inf  # height above it of the lowest look that found it
    in_view: bool = False  # of the newest look
    only_cut: bool = False  # every report of it was cut by the picture's edge
    distinct: set[int] = field(default_factory=set)  # others found in the same look
    account: Account = field(default_factory=Account)


class Suspects:
    """All candidates of a mission."""

    def __init__(self, context: MissionContext, parameters: BeliefParameters) -> None:
        self._context, self._parameters = context, parameters
        self._hypotheses: dict[str, Hypotheses] = {}
        context.occluders.around(np.zeros(3), 1.0)  # known and compiled now, not in flight
        self._looks: list[Look] = []  # so far, or since the flight was resumed
        self._eyes, self._Rs = np.empty((0, 3)), np.empty((0, 3, 3))  # of these, with room for more
        self.all: dict[int, Suspect] = {}
        self._probabilities: dict[int, float] = {}  # asked for since they changed
        t, g = parameters.target_share, parameters.ghost_share
        self._prior = np.array([t, (1.0 - t) * (1.0 - g), (1.0 - t) * g])
        self._assume(self._prior)
        self.fit = Fit()

    def hypotheses(self, class_name: str) -> Hypotheses:
        """What a candidate that is reported as this class may be."""
        if class_name not in self._hypotheses:
            self._hypotheses[class_name] = Hypotheses(self._context, class_name, self._parameters)
        return self._hypotheses[class_name]

    def nothing(self, candidate_id: int) -> float:
        """How probably nothing is at a candidate's place, before any look, if it is no target."""
        _, thing, nothing = self._shares.tolist()
        suspect = self.all[candidate_id]
        hypotheses = self.hypotheses(suspect.class_name)
        nothing *= math.exp(hypotheses.clutter(suspect.place_enu_m, suspect.only_cut))
        return float(nothing / (thing + nothing))

    @property
    def reported(self) -> float:
        """Probability that a passing of the scan reports a target, of the class that it reports least."""
        return min((h.reported for h in self._hypotheses.values()), default=1.0)

    def _assume(self, shares: F64) -> None:
        self._shares = shares
        self._prior_odds = math.log(shares[0] / (1.0 - shares[0]))
        self._probabilities.clear()

    def probability(self, candidate_id: int) -> float:
        """That a candidate is what is searched for."""
        if candidate_id not in self._probabilities:
            log_odds = self.all[candidate_id].evidence + self._prior_odds
            odds = math.exp(-min(max(log_odds, -500.0), 500.0))
            self._probabilities[candidate_id] = 1.0 / (1.0 + odds)
        return self._probabilities[candidate_id]

    def moved(self, settled: Container[int]) -> list[int]:
        """Those that are not settled and whose probability is to be told again."""
        odds = self._prior_odds
        return [k for k, s in self.all.items() if k not in settled and s.account.has_moved(s.evidence + odds)]

    def tell(self, candidate_id: int) -> str:
        """The looks that moved a candidate's probability since it was last told, in words."""
        suspect = self.all[candidate_id]
        words = suspect.account.words()
        suspect.account = Account(within_clear(suspect.evidence + self._prior_odds))
        return words

    def _learn(self) -> None:
        """How many candidates of this place are what, and how targets look: expectation maximisation."""
        suspects = list(self.all.values())
        likely = np.array([s.likely for s in suspects])
        prior = self._parameters.share_weight * self._prior
        shares, targets, evidence = _maximise(likely, self._shares, prior, _EM_STEPS)
        self._assume(shares)
        for suspect, of_it in zip(suspects, evidence.tolist(), strict=True):
            suspect.evidence = of_it
        if self.fit.learn_shift(targets, np.array([s.shift for s in suspects])):
            for suspect in suspects:
                self._weigh(suspect)

    def _weigh(self, suspect: Suspect) -> None:
        hypotheses = self.hypotheses(suspect.class_name)
        target, thing, nothing, total, weight = hypotheses.evidence(
            suspect.belief, suspect.place_enu_m, self.fit.shift, suspect.only_cut
        )
        suspect.likely, suspect.shift = (target, thing, nothing), (total, weight)
        shares = self._shares[1:] / self._shares[1:].sum()
        suspect.evidence = _against(target, thing, nothing, shares[0], shares[1])
        self._probabilities.pop(suspect.id, None)

    def take(self, look: Look, candidates: Mapping[int, Candidate], settled: Container[int]) -> list[int]:
        """Update what is believed of every candidate that is not settled; those that are new."""
        hits = {hit.candidate_id: hit for hit in look.hits}
        new = [k for k in hits if k not in self.all]
        for k in hits:
            if k in new:
                class_name, place = candidates[k].class_name, candidates[k].position_enu_m
                fresh = self.hypotheses(class_name).fresh()
                self.all[k] = Suspect(k, class_name, fresh, place, only_cut=hits[k].is_cut)
                self._recall(self.all[k], candidates, look.lens)
                self._weigh(self.all[k])
            self.all[k].distinct |= {j for j in hits if self._are_apart(hits[j], hits[k], candidates)}
        self._remember(look)
        open_ = [s for k, s in self.all.items() if k not in settled]
        if not open_:
            return new
        places = np.concatenate([candidates[k].position_enu_m for k in self.all]).reshape(-1, 3)
        uv, depth = project(look.lens, look.camera, places)
        size_px = [look.lens.width_px, look.lens.height_px]
        inside = (uv >= 0.0) & (uv <= size_px)
        in_view = (depth > 0.0) & inside[:, 0] & inside[:, 1]
        n_in_view = int(in_view.sum())
        whole = _is_whole(look.lens, uv, depth, np.array([self._reach_m(s) for s in self.all.values()]))
        rows = zip(self.all.values(), places, in_view.tolist(), whole.tolist(), strict=True)
        for suspect, place, is_in_view, is_whole in rows:
            if suspect.id in settled:
                continue
            suspect.in_view = is_in_view
            hit, others = hits.get(suspect.id), n_in_view - is_in_view
            if hit is not None:
                suspect.lowest_m = min(suspect.lowest_m, hit.camera_altitude_agl_m)
                suspect.only_cut &= hit.is_cut
                if not hit.is_cut:
                    self._update(suspect, look, place, hit.confidence, others)
            elif is_whole and not self._is_told(suspect, list(hits), candidates):
                self._update(suspect, look, place, None, others)
        self._learn()
        return new

    def twins(
        self, of: Sequence[int], among: Sequence[int], candidates: Mapping[int, Candidate]
    ) -> dict[int, int]:
        """For each candidate that may be one thing with another one ``among`` these: the first such."""
        found: dict[int, int] = {}
        if not of or not among:
            return found
        a = np.array([candidates[k].position_enu_m[:2] for k in of])
        b = np.array([candidates[k].position_enu_m[:2] for k in among])
        near = np.abs(a[:, None] - b).sum(axis=2) <= _SAME_FAR_M
        for i, j in zip(*np.nonzero(near), strict=True):
            if of[i] not in found and of[i] != among[j] and self.may_be_same(of[i], among[j], candidates):
                found[of[i]] = among[j]
        return found

    def shadowed(
        self, of: Sequence[int], among: Sequence[int], candidates: Mapping[int, Candidate]
    ) -> set[int]:
        """Those that may be one thing with one ``among`` others, or with a likelier one of themselves."""
        likely = sorted(of, key=self.probability, reverse=True)
        rank = {k: i for i, k in enumerate(likely)}
        twins = self.twins(likely, likely, candidates)
        likelier = {k for k, other in twins.items() if rank[other] < rank[k]}
        return likelier.union(self.twins(of, among, candidates))

    def may_be_same(self, a: int, b: int, candidates: Mapping[int, Candidate]) -> bool:
        """Whether two candidates may be one thing: never found in one look, and near enough."""
        if self.all[a].class_name != self.all[b].class_name or b in self.all[a].distinct:
            return False
        one, other = candidates[a], candidates[b]
        x, y, _ = (one.position_enu_m - other.position_enu_m).tolist()
        if abs(x) + abs(y) > _SAME_FAR_M:
            return False
        (xx, xy), (_, yy) = (one.covariance_m2 + other.covariance_m2).tolist()
        xx, yy = xx + _SAME_STD_M**2, yy + _SAME_STD_M**2
        squared = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
        return bool(squared <= _SAME_GATE)

    def _are_apart(self, a: Sighting, b: Sighting, candidates: Mapping[int, Candidate]) -> bool:
        """Whether two boxes of a picture are of two things: a large one may get two, near each other."""
        kind, other = (candidates[hit.candidate_id].class_name for hit in (a, b))
        apart_m = math.dist(a.position_enu_m[:2].tolist(), b.position_enu_m[:2].tolist())
        return kind != other or apart_m >= _OF_ONE * self._context.sizes_m[kind][1]

    def _is_told(self, suspect: Suspect, found: Sequence[int], candidates: Mapping[int, Candidate]) -> bool:
        """Whether another candidate that may be the same thing was found instead."""
        return any(self.may_be_same(suspect.id, k, candidates) for k in found)

    def _reach_m(self, suspect: Suspect) -> float:
        """From a candidate's place to where a target there may end."""
        return 0.5 * self._context.sizes_m[suspect.class_name][1] + _UNSURE_M

    def _remember(self, look: Look) -> None:
        n = len(self._looks)
        if n == len(self._eyes):
            self._eyes = np.resize(self._eyes, (2 * n + 64, 3))
            self._Rs = np.resize(self._Rs, (2 * n + 64, 3, 3))
        self._eyes[n], self._Rs[n] = look.camera.position_enu_m, look.camera.R_camera_to_enu
        self._looks.append(look)

    def _recall(self, suspect: Suspect, candidates: Mapping[int, Candidate], lens: Lens) -> None:
        """The looks before this one that missed it; of what may move, those of the same passing."""
        place, n = candidates[suspect.id].position_enu_m, len(self._looks)
        seen_from = np.einsum("nij,ni->nj", self._Rs[:n], place - self._eyes[:n])
        uv, depth = projected(lens, seen_from)
        whole = _is_whole(lens, uv, depth, np.full(n, self._reach_m(suspect)))
        if self._context.search.target_speed_mps:
            whole &= np.logical_and.accumulate(whole[::-1])[::-1]
        for look in (self._looks[i] for i in np.flatnonzero(whole).tolist()):
            if not self._is_told(suspect, [hit.candidate_id for hit in look.hits], candidates):
                self._update(suspect, look, place, None, len(look.hits))

    def _update(
        self, suspect: Suspect, look: Look, place: F64, confidence: float | None, others: int
    ) -> None:
        shown = 1.0  # a hit shows something
        if confidence is None:
            shown = self._context.shown(place, look.camera.position_enu_m)
        score = None if confidence is None else float(score_of(confidence))
        surprise = self.hypotheses(suspect.class_name).look(
            suspect.belief, look.camera, place, score, self.fit.widened, others, shown
        )
        if score is not None:
            self.fit.learn_spread(self.probability(suspect.id), surprise)
        suspect.account.look(float(look.camera.position_enu_m[2] - place[2]), confidence)
        suspect.n_looks += 1
        suspect.place_enu_m = place
        self._weigh(suspect)

    def snapshot(self) -> dict[str, Any]:
        """As plain data, without the looks."""
        return {
            "shares": self._shares.tolist(),
            "fit": asdict(self.fit),
            "suspects": [
                {
                    **{name: getattr(s, name) for name in _PLAIN},
                    "belief": [[None if math.isnan(x) else x for x in row] for row in s.belief.tolist()],
                    "lowest_m": s.lowest_m if math.isfinite(s.lowest_m) else None,
                    "place_enu_m": s.place_enu_m.tolist(),
                    "distinct": sorted(s.distinct),
                    "likely": list(s.likely),
                    "shift": list(s.shift),
                    "account": list(astuple(s.account)),
                }
                for s in self.all.values()
            ],
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go on from a snapshot."""
        self._assume(np.array(snapshot["shares"]))
        self.fit = Fit(**snapshot["fit"])
        self.all = {
            s["id"]: Suspect(
                **{name: s[name] for name in _PLAIN},
                belief=np.array(s["belief"], dtype=float),
                lowest_m=math.inf if s["lowest_m"] is None else s["lowest_m"],
                place_enu_m=np.array(s["place_enu_m"], dtype=float),
                distinct=set(s["distinct"]),
                likely=(s["likely"][0], s["likely"][1], s["likely"][2]),
                shift=(s["shift"][0], s["shift"][1]),
                account=Account(*s["account"]),
            )
            for s in snapshot["suspects"]
        }


def _is_whole(lens: Lens, uv: F64, depth_m: F64, reach_m: F64) -> NDArray[np.bool_]:
    """(N,) whether all of what reaches so far around points at these pixels (N, 2) is in the picture."""
    margin = reach_m * lens.focal_px / np.maximum(depth_m, 0.3)
    margin = np.minimum(margin, 0.3 * lens.height_px)[:, None]
    inside = (uv >= margin) & (uv <= [lens.width_px, lens.height_px] - margin)
    return np.asarray((depth_m > 0.0) & inside[:, 0] & inside[:, 1])


@njit(cache=True)
def _maximise(likely: F64, shares: F64, prior: F64, steps: int) -> tuple[F64, F64, F64]:
    """The ``shares`` (3,) of targets, things and nothing after some steps of expectation maximisation.

    ``likely`` (N, 3) are log likelihoods, ``prior`` (3,) counts as so many more candidates. Also of each
    candidate how probably it is a target, by the shares before the last step, and its log likelihood ratio.
    """
    n = len(likely)
    targets, evidence = np.empty(n), np.empty(n)
    for _ in range(steps):
        found = prior.copy()
        for i in range(n):
            most = max(likely[i, 0], likely[i, 1], likely[i, 2])
            target = math.exp(likely[i, 0] - most) * shares[0]
            thing = math.exp(likely[i, 1] - most) * shares[1]
            nothing = math.exp(likely[i, 2] - most) * shares[2]
            total = target + thing + nothing
            targets[i] = target / total
            found[0] += target / total
            found[1] += thing / total
            found[2] += nothing / total
        shares = found / found.sum()
    a, b = shares[1] / (shares[1] + shares[2]), shares[2] / (shares[1] + shares[2])
    for i in range(n):
        evidence[i] = _against(likely[i, 0], likely[i, 1], likely[i, 2], a, b)
    return shares, targets, evidence


@njit(cache=True)
def _against(target: float, thing: float, nothing: float, thing_share: float, nothing_share: float) -> float:
    """Log likelihood ratio: a target against anything else."""
    a, b = thing + math.log(thing_share), nothing + math.log(nothing_share)
    return target - max(a, b) - math.log1p(math.exp(-abs(a - b)))
