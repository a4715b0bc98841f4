"""Belief without each of its ingredients in turn: the table in docs/belief.md.

python tools/ablate_belief.py            # 100 seeds a family, without pictures: an hour on two cores
python tools/ablate_belief.py 4          # 4 seeds
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from skysweep.experiments.sweep.spec import load_spec, scenarios_of
from skysweep.flights.fly import fly_in_memory
from skysweep.planning.routing import tour_from
from skysweep.scenarios.model import Scenario
from skysweep.strategies.belief import checks, hypotheses
from skysweep.strategies.belief.candidates import Suspects
from skysweep.strategies.belief.checks import Checks
from skysweep.strategies.belief.fit import Fit
from skysweep.strategies.belief.ground import Ground
from skysweep.strategies.belief.hypotheses import Hypotheses

SWEEP = Path(__file__).parent.parent / "examples" / "belief.yaml"
FAMILIES = ("clusters", "sparse-random", "maritime", "person-wilderness")
FIRST_SEED = 50_000  # as the sweep
_SHARES = [
    hypotheses._OBJECT_SHARE,
    hypotheses._ASPECT_SHARE,
    hypotheses._LAPSE_OBJECT_SHARE,
    hypotheses._LAPSE_ASPECT_SHARE,
]
init, learn = Hypotheses.__init__, Suspects._learn


def independent(self: Hypotheses, *arguments: Any) -> None:
    init(self, *arguments)
    self._numbers[:, _SHARES] = 0.0


def visit_all(_: Checks, here: Any, places: Any, losses_s: Any) -> list[int]:
    chosen = np.nonzero(np.array(losses_s) > 0.0)[0]
    return [int(k) for k in chosen[tour_from(here, places[chosen])]]


def all_reported(_: Hypotheses, context: Any, weights: Any) -> Any:
    return np.ones(len(weights))


def keep_the_shares(self: Suspects) -> None:
    learn(self)
    self._assume(self._prior)
    for suspect in self.all.values():
        self._weigh(suspect)


def no_view(_: Checks, *arguments: Any) -> None:
    return None


def go_home(_: Ground, *arguments: Any) -> None:
    return None


ABLATIONS: dict[str, list[Callable[[], Any]]] = {
    "nothing": [],
    "what looks have in common": [lambda: patch.object(Hypotheses, "__init__", independent)],
    "what a scan does not report": [lambda: patch.object(Hypotheses, "_reported", all_reported)],
    "where false reports are dense": [lambda: patch.object(Hypotheses, "clutter", lambda *_: 0.0)],
    "learning what share is what": [lambda: patch.object(Suspects, "_learn", keep_the_shares)],
    "learning how targets look": [
        lambda: patch.object(Fit, "learn_shift", lambda *_: False),
        lambda: patch.object(Fit, "learn_spread", lambda *_: None),
    ],
    "leaving out what does not pay": [lambda: patch.object(Checks, "route", visit_all)],
    "other views": [lambda: patch.object(Checks, "next_view", no_view)],
    "looks before it was found": [lambda: patch.object(Suspects, "_recall", lambda *_: None)],
    "slowing down in passing": [lambda: patch.object(checks, "_IN_PASSING", 1e-3)],
    "looking again at weakly searched ground": [lambda: patch.object(Ground, "again", go_home)],
}


def fly(job: tuple[str, Scenario, int]) -> tuple[float, float, float, float]:
    """Mission time in s, recall, false positives, and time in s to half of the targets."""
    ablation, scenario, seed = job
    with ExitStack() as patched:
        for part in ABLATIONS[ablation]:
            patched.enter_context(part())
        s = fly_in_memory(scenario, seed)
    found = sorted(t for t in s["time_to_confirm_s"] if t is not None)
    half = (s["n_targets"] + 1) // 2
    to_half_s = found[half - 1] if len(found) >= half else s["mission_time_s"]
    return s["mission_time_s"], s["recall"], s["false_positives"], to_half_s


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    seeds, rows = range(FIRST_SEED, FIRST_SEED + n), dict(scenarios_of(load_spec(SWEEP)))
    print("| without | " + " | ".join(FAMILIES) + " |")
    print("|---|" + "---|" * len(FAMILIES))
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:

        def flown(ablation: str, label: str, family: str) -> np.ndarray:
            jobs = [(ablation, rows[f"{family}-{label}"], seed) for seed in seeds]
            return np.array(list(pool.map(fly, jobs, chunksize=4)))

        scan_s = {family: flown("nothing", "scan-only", family)[:, 0] for family in FAMILIES}
        for ablation in ABLATIONS:
            cells = []
            for family in FAMILIES:
                means = flown(ablation, "belief", family).mean(axis=0)
                time_s, recall, false_positives, half_s = means
                above_s = time_s - scan_s[family].mean()
                cells.append(f"{above_s:.0f} s, {recall:.3f}, {false_positives:.2f}, {half_s:.0f} s")
            print(f"| {ablation} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
