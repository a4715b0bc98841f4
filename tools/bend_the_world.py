"""Belief and tuned Algorithm 1 where the detector differs from the sensor model: the table in docs/belief.md.

python tools/bend_the_world.py           # 60 seeds a family, without pictures: half an hour on two cores
python tools/bend_the_world.py 4         # 4 seeds
python tools/bend_the_world.py 30 defaults   # belief with its defaults, as in the shipped scenarios
"""

from __future__ import annotations

import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from unittest.mock import patch

import numpy as np

import skysweep.flights.build as build
from skysweep.experiments.sweep.spec import load_spec, scenarios_of
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.results.metrics import compute_summary
from skysweep.results.run_folder import Run
from skysweep.scenarios.model import Scenario
from skysweep.sensing.statistical.model import KindModel, StatisticalModel, model_for
from skysweep.types import EventKind

SWEEP = Path(__file__).parent.parent / "examples" / "belief.yaml"
FAMILIES = ("clusters", "abundance", "sparse", "maritime", "person-wilderness")
FIRST_SEED = 50_000  # as the sweep
RESAMPLED = 2000


def is_target(kind: KindModel) -> bool:
    return kind.kind == kind.reported_as


def shifted(kind: KindModel, by: float) -> KindModel:
    return kind.model_copy(update={"score": [score + by for score in kind.score]})


WORLDS: dict[str, Callable[[KindModel], KindModel]] = {
    "scores of targets 0.4 lower": lambda k: shifted(k, -0.4) if is_target(k) else k,
    "spread of all scores x 1.4": lambda k: k.model_copy(update={"spread": [1.4 * s for s in k.spread]}),
    "share of an object's own luck 0.6": lambda k: k.model_copy(update={"object_share": 0.6}),
    "scores of look-alikes 0.5 higher": lambda k: k if is_target(k) else shifted(k, 0.5),
}


def fly(job: tuple[str, Scenario, int]) -> tuple[float, float, float]:
    """Recall, false positives, and whether the strategy said that its model does not fit."""
    world, scenario, seed = job

    def bent(of: Scenario, *more: str) -> StatisticalModel:
        """For the sensor; the strategy keeps the model as it was calibrated."""
        model = model_for(of, *more)
        return model.model_copy(update={"kinds": [WORLDS[world](kind) for kind in model.kinds]})

    journal = MemoryJournal()
    with (
        patch.object(build, "model_for", bent),
        Flight(build.build_mission(scenario, seed, Rig("statistical")), journal) as flight,
    ):
        for _ in flight:
            pass
    summary = compute_summary(Run(scenario, tuple(journal.lines)))
    said = any(line["kind"] == EventKind.MISFIT for line in journal.lines)
    return summary["recall"], summary["false_positives"], float(said)


def main() -> None:
    n = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    seeds, rows = range(FIRST_SEED, FIRST_SEED + n), dict(scenarios_of(load_spec(SWEEP)))
    rng = np.random.default_rng(0)
    print("| the world's detector | " + " | ".join(FAMILIES) + " |")
    print("|---|" + "---|" * len(FAMILIES))
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        for world in WORLDS:
            cells = []
            for family in FAMILIES:
                searches = rows[f"{family}-belief"], rows[f"{family}-tuned"]
                if "defaults" in sys.argv[2:]:
                    searches = rows[f"{family}-scan-only"].with_search(strategy="belief"), searches[1]
                belief, tuned = (
                    np.array(list(pool.map(fly, [(world, scenario, s) for s in seeds], chunksize=4)))
                    for scenario in searches
                )
                drawn = rng.integers(0, n, (RESAMPLED, n))
                low, high = np.quantile((belief - tuned)[:, 0][drawn].mean(axis=1), [0.025, 0.975])
                recall, false, said = belief.mean(axis=0)
                cells.append(
                    f"{recall:.3f}, {tuned[:, 0].mean():.3f} ({low:+.3f} to {high:+.3f}); "
                    f"{false:.2f}, {tuned[:, 1].mean():.2f}; {said:.0%}"
                )
            print(f"| {world} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
