"""What was searched before: run folders and plans."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skysweep.arrays import F64
from skysweep.cli.common import warn
from skysweep.detection.model_files import sha256_of
from skysweep.errors import UserError
from skysweep.planning.prior.checks import positive
from skysweep.planning.prior.flown import path_of_plan
from skysweep.planning.prior.maps import ProbabilityMap
from skysweep.results.reporting.wording import moving_words
from skysweep.results.run_folder import JOURNAL_FILE, Run, load_run
from skysweep.results.searched import coverage_of_runs, scanned_paths


def coverage_of_searches(
    cells: ProbabilityMap,
    searched: Sequence[Path],
    sweep_width_of_runs_m: float | None,
    sweep_width_of_plans_m: float | None,
) -> tuple[F64, list[F64]]:
    """Coverage (R, C) of a map's cells by run folders and plans, and their paths (K, 2).

    Without a sweep width, runs count by their calibrated sensor, look by look; a plan needs one.
    """
    for width_m in (sweep_width_of_runs_m, sweep_width_of_plans_m):
        if width_m is not None:
            positive(width_m, "--sweep-width-m")
    _refuse_twice(searched)
    coverage, paths, runs = np.zeros(cells.poa.shape), list[F64](), list[Run]()
    for path in searched:
        if path.is_dir():
            if not (path / JOURNAL_FILE).exists():
                raise UserError(
                    f"--searched {path}: holds no {JOURNAL_FILE}; give a run's folder or a .plan file"
                )
            run = load_run(path)
            if words := moving_words(run.scenario):
                warn(f"--searched {path}: {words}")
            confirmed = sum(candidate.verdict == "confirmed" for candidate in run.candidates)
            if confirmed:
                warn(f"--searched {path}: confirmed {confirmed}; the map is of what is still missing")
            if run.unchecked:
                warn(
                    f"--searched {path}: left {len(run.unchecked)} candidates unchecked; check them first, "
                    "as the map counts them as nothing"
                )
            if not run.ended:
                warn(f"--searched {path}: was interrupted or is still flying; what it flew so far counts")
            runs.append(run)
            paths += scanned_paths(run, cells.frame)
        elif sweep_width_of_plans_m is None:
            raise UserError(f"--sweep-width-m: is missing; write that of the sensor that flew {path}")
        else:
            paths.append(path_of_plan(path, cells.frame))
            coverage += cells.coverage_by(paths[-1:], sweep_width_of_plans_m)
    return coverage + coverage_of_runs(runs, cells, sweep_width_of_runs_m), paths


def _refuse_twice(searched: Sequence[Path]) -> None:
    """Raises UserError if two plans are one file; a copy was flown once more."""
    known: dict[str, Path] = {}
    for path in (path for path in searched if path.is_file()):
        if (other := known.setdefault(sha256_of(path), path)) is path:
            continue
        if path.samefile(other):
            raise UserError(f"--searched {path}: is the same plan as {other}; name each once")
        warn(f"--searched {path}: is a copy of {other}; both count, as if it was flown twice")
