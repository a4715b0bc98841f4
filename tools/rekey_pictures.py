"""Key ``docs/data/missions-with-pictures`` anew after a change that alters no mission, or one strategy's.

    python tools/rekey_pictures.py 3
    python tools/rekey_pictures.py 3 belief     # all 90 of that strategy are flown: half an hour on two cores

A mission's key holds every field of its scenario, so that a new field is another key, as is another
``RESULTS_VERSION``. This flies as many of the kept missions again, a minute or two each, and where these come
out as they are kept, all are written with the keys of today.
"""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from skysweep.experiments.calibration.tiers import validated_rows
from skysweep.experiments.matrix import Matrix, MissionJob
from skysweep.experiments.paper.run import SWEPT
from skysweep.experiments.store import TIMINGS, MissionStore, row_of, summary_of
from skysweep.experiments.workers import run_jobs
from skysweep.files.folder import Folder
from skysweep.flights.fly import fly_in_memory
from skysweep.results.summary import Summary

KEPT = Path(__file__).parents[1] / "docs" / "data" / "missions-with-pictures"
SEEDS = 30


def rekeyed(summaries: list[Summary], out: Path, again: int, anew: tuple[str, ...] = ()) -> None:
    """Write missions of the paper's scenarios into ``out``, those of the strategies ``anew`` as they fly now.

    Raises ValueError where another flies otherwise.
    """
    rows = [(label, scenario) for label, _, scenario in validated_rows()]
    matrix = Matrix.of(rows, range(SEEDS), "imaging", [SWEPT])
    kept = {(s["scenario"], s["strategy"], float(s["n_c"]), s["seed"]): s for s in summaries}
    searches = [(job, job.scenario.search) for job in matrix.jobs()]
    flown_anew = [job for job, s in searches if s.strategy in anew]
    found = [
        (job, kept[job.label, s.strategy, s.n_c, job.seed]) for job, s in searches if s.strategy not in anew
    ]
    for job, summary in found[:: -(-len(found) // again)] if again else ():
        flown = fly_in_memory(job.scenario, job.seed, job.sensor)
        told = [(k, v) for k, v in summary.items() if v is not None and k not in TIMINGS]
        other = [k for k, v in told if not _is_same(v, flown.get(k))]
        if other:
            raise ValueError(f"{job.label}, seed {job.seed}: flies otherwise now ({', '.join(other)})")
    found += run_jobs(_fly, flown_anew)
    store = MissionStore(Folder(out))
    store.append([row_of(job.label, job.config_hash, summary) for job, summary in found], matrix.table())
    store.finish_all()


def _is_same(kept: Any, flown: Any) -> bool:
    """Whether two results are equal; another processor rounds sums otherwise."""
    if isinstance(kept, list) and isinstance(flown, list):
        return len(kept) == len(flown) and all(map(_is_same, kept, flown))
    if isinstance(kept, float) and isinstance(flown, float):
        return math.isclose(kept, flown, rel_tol=1e-4)
    return bool(kept == flown)


def _fly(job: MissionJob) -> Summary:
    return fly_in_memory(job.scenario, job.seed, job.sensor)


if __name__ == "__main__":
    held = MissionStore(Folder(KEPT)).outcomes().iter_rows(named=True)
    with TemporaryDirectory() as new:
        rekeyed([summary_of(row) for row in held], Path(new), int(sys.argv[1]), tuple(sys.argv[2:]))
        shutil.copytree(new, KEPT, dirs_exist_ok=True)
