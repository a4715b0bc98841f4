"""Key ``docs/data/missions-with-pictures`` anew after a change that alters no mission.

    python tools/rekey_pictures.py 3

A mission's key holds every field of its scenario, so that a new field is another key. This flies as many of
the kept missions again, a minute or two each, and where these come out as they are kept, all are written with
the keys of today.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from skysweep.experiments.calibration.tiers import validated_rows
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.paper.run import SWEPT
from skysweep.experiments.store import TIMINGS, MissionStore, row_of, summary_of
from skysweep.files.folder import Folder
from skysweep.flights.fly import fly_in_memory
from skysweep.results.summary import Summary

KEPT = Path(__file__).parents[1] / "docs" / "data" / "missions-with-pictures"
SEEDS = 30


def rekeyed(summaries: list[Summary], out: Path, again: int) -> None:
    """Write missions of the paper's scenarios into ``out``. Raises ValueError where one flies otherwise."""
    rows = [(label, scenario) for label, _, scenario in validated_rows()]
    matrix = Matrix.of(rows, range(SEEDS), "imaging", [SWEPT])
    kept = {(s["scenario"], s["strategy"], float(s["n_c"]), s["seed"]): s for s in summaries}
    searches = [(job, job.scenario.search) for job in matrix.jobs()]
    found = [(job, kept[job.label, s.strategy, s.n_c, job.seed]) for job, s in searches]
    for job, summary in found[:: -(-len(found) // again)] if again else ():
        flown = fly_in_memory(job.scenario, job.seed, job.sensor)
        other = [k for k, v in summary.items() if v is not None and v != flown.get(k) and k not in TIMINGS]
        if other:
            raise ValueError(f"{job.label}, seed {job.seed}: flies otherwise now ({', '.join(other)})")
    store = MissionStore(Folder(out))
    store.append([row_of(job.label, job.config_hash, summary) for job, summary in found], matrix.table())
    store.finish_all()


if __name__ == "__main__":
    held = MissionStore(Folder(KEPT)).outcomes().iter_rows(named=True)
    with TemporaryDirectory() as new:
        rekeyed([summary_of(row) for row in held], Path(new), int(sys.argv[1]))
        shutil.copytree(new, KEPT, dirs_exist_ok=True)
