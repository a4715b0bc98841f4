"""What belief confirms, and how true its probabilities are: the figures in docs/belief.md.

python tools/what_is_confirmed.py        # 20 seeds that belief was tuned on, without pictures: minutes
python tools/what_is_confirmed.py 20 1   # look-alikes' lapses in common counted in full, not by half
"""

from __future__ import annotations

import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from skysweep.experiments.sweep.spec import load_spec, scenarios_of
from skysweep.flights.build import build_mission
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Scenario
from skysweep.strategies.belief import hypotheses

SWEEP = Path(__file__).parent.parent / "examples" / "belief.yaml"
FIRST_SEED = 70_000
NEAR_M = 6.0
LEAST = 1e-4  # probabilities are taken as at least that far from 0 and 1


def candidates(job: tuple[Scenario, int, float]) -> list[tuple[str, float, bool]]:
    """What stands nearest to each candidate, its last probability, and whether it is confirmed."""
    scenario, seed, hypotheses._KNOWN_OF_THINGS = job
    journal = MemoryJournal()
    with Flight(build_mission(scenario, seed, Rig("statistical")), journal) as flight:
        for _ in flight:
            pass
    run, found, taken = Run(scenario, tuple(journal.lines)), [], set()
    for candidate in sorted(run.candidates, key=lambda c: (c.verdict != "confirmed", c.verdict_s or 0.0)):
        if candidate.probability is None:
            continue
        things = [
            (run.world.position(thing, candidate.looked_s or 0.0), thing) for thing in run.world.objects
        ]
        away_m = [float(np.hypot(*(place - candidate.position_enu_m)[:2])) for place, _ in things]
        k = int(np.argmin(away_m))
        what = (
            "nothing" if away_m[k] > NEAR_M else "a target" if things[k][1].is_target else things[k][1].kind
        )
        if what == "a target":
            what = "a target once more" if k in taken else what
            taken.add(k)
        found.append((what, candidate.probability, candidate.verdict == "confirmed"))
    return found


def log_loss(found: list[tuple[str, float, bool]]) -> float:
    """Of all candidates' probabilities, summed; what is reported twice counts once."""
    of_truth = [p if what == "a target" else 1.0 - p for what, p, _ in found if what != "a target once more"]
    return float(-np.log(np.clip(of_truth, LEAST, 1.0 - LEAST)).sum())


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    known = float(sys.argv[2]) if len(sys.argv) > 2 else hypotheses._KNOWN_OF_THINGS
    rows = [row for row in scenarios_of(load_spec(SWEEP)) if row[0].endswith("belief")]
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        for name, scenario in rows:
            jobs = [(scenario, seed, known) for seed in range(FIRST_SEED, FIRST_SEED + n)]
            found = [one for mission in pool.map(candidates, jobs) for one in mission]
            confirmed = [(what, probability) for what, probability, is_confirmed in found if is_confirmed]
            if not confirmed:
                print(f"{name}, {n} seeds: nothing was confirmed")
                continue
            right = sum(what == "a target" for what, _ in confirmed) / len(confirmed)
            said = sum(probability for _, probability in confirmed) / len(confirmed)
            print(f"{name}, {n} seeds: log loss {log_loss(found) / n:.2f} a mission;", end=" ")
            print(f"confirmed: {said:.2f} said, {right:.2f} are targets;", end=" ")
            print(
                ", ".join(f"{what} {count}" for what, count in Counter(w for w, _ in confirmed).most_common())
            )


if __name__ == "__main__":
    main()
