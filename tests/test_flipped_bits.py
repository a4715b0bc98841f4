"""One wrong bit anywhere in a folder that later commands read: it is refused, or nothing changes.

``python tests/test_flipped_bits.py 10000`` tries that often, with the pictures of a rendered mission, and
counts what happened. The tests try a sample.
"""

from __future__ import annotations

import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.errors import UserError
from skysweep.experiments.engines import LocalEngine
from skysweep.experiments.flying import fly_missing
from skysweep.experiments.matrix import Matrix
from skysweep.experiments.paper.report import drawn_runs
from skysweep.experiments.paper.run import fly_paper_job, row_scenario
from skysweep.experiments.paper.tables import compare_rows
from skysweep.experiments.store import MissionStore
from skysweep.experiments.sweep.missions import load_missions
from skysweep.experiments.sweep.run import Sweep, fly_job
from skysweep.experiments.sweep.spec import dump_spec, matrix_of, parse_spec
from skysweep.experiments.tune.race import Outcomes, RaceRules
from skysweep.experiments.tune.run import Problem, family_of, search
from skysweep.experiments.tune.space import CHECK_SPEED, N_C, TUNED, changed_space, default_space
from skysweep.experiments.tune.study import TuningStudy
from skysweep.experiments.tune.validate import candidates_of, fly_candidates
from skysweep.experiments.workers import run_jobs
from skysweep.files.folder import Folder
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.results.picture_files import picture_name, write_picture
from skysweep.results.run_folder import load_run
from skysweep.results.summary import Summary
from skysweep.scenarios.files import dump_scenario, write_scenario
from skysweep.scenarios.model import Scenario

SHORT = {
    "name": "short",
    "area": {"polygon_enu_m": [[0, 0], [8, 0], [8, 6], [0, 6]]},
    "home": {"position_enu_m": [-12, -3]},
    "targets": [{"class": "stop sign", "position_enu_m": [4, 3], "size_m": 0.9}],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1, "scan_altitude_agl_m": 8},
}
SPEC = """
name: small
scenarios:
  - scenario:
      name: field
      area: {polygon_enu_m: [[0, 0], [24, 0], [24, 12], [0, 12]]}
      home: {position_enu_m: [-2, -2]}
      generators: [{class: stop sign, pattern: uniform, count: 1, size_m: 0.9, seed: null}]
      search: {scan_altitude_agl_m: 12}
parameters:
  search.n_c: [1, .inf]
seeds: 3
"""
READ_BACK = ("config.yaml", "journal.jsonl", "summary.json", "study.db")
TRIALS, SEEDS, FRESH_SEEDS = 5, 4, 3
RANGES = ("search.n_c=1,5,inf", "search.check_speed_mps=2:4")
FIXED = tuple(field for field in TUNED if field not in (N_C, CHECK_SPEED))


@dataclass(frozen=True)
class Kept:
    """A folder, what its readers make of it, and the command that reads it."""

    folder: Path
    told: Callable[[Path], Any]
    share: float  # of the tries
    command: Callable[[Path, Path], list[str]] = lambda kept, out: ["report", str(kept), "--out", str(out)]


def flown(folder: Path, sensor: str) -> Path:
    """A mission's folder; one without a camera gets a picture as a camera's are written."""
    fly_to_folder(Scenario.model_validate(SHORT), 2, folder, Rig(sensor))
    if sensor == "statistical":
        (folder / "pictures").mkdir()
        candidate = load_run(folder).candidates[0]
        _, jpeg = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, (90, 160, 3), np.uint8))
        name = picture_name(candidate.id, candidate.verdict_s or 0.0)
        write_picture(folder / "pictures" / name, jpeg.tobytes())
    return folder


def broken_off(whole: Path, folder: Path) -> Path:
    """As a kill in the middle of a line leaves a mission."""
    shutil.copytree(whole / "pictures", folder / "pictures")
    shutil.copy(whole / "config.yaml", folder)
    content = (whole / "journal.jsonl").read_bytes()
    (folder / "journal.jsonl").write_bytes(content[: 2 * len(content) // 3])
    return folder


def swept(folder: Path, complete: bool) -> Path:
    spec = parse_spec(SPEC, "spec.yaml")
    if complete:
        Sweep(spec, folder).fly(LocalEngine(1))
        return folder
    matrix, store = matrix_of(spec), MissionStore(Folder(folder))
    store.write_spec(dump_spec(spec))
    for jobs in ((0, 1), (2, 4)):
        store.append([fly_job(matrix.job(k)) for k in jobs])
    return folder


def compared(folder: Path) -> Path:
    folder.mkdir()
    compare(folder)
    return folder


def compare(folder: Path) -> list[Summary]:
    """Two rows of ``compare paper``, a seed with a run folder and one without."""
    rows = [row_scenario("sparse", n_c, {}) for n_c in (1.0, np.inf)]
    matrix = Matrix.of(rows, range(2), "statistical", ["search.n_c"])
    flown = fly_missing([matrix], partial(fly_paper_job, out=folder), folder, 1)
    return [flown[job.config_hash] for job in matrix.jobs()]


@cache
def problem() -> Problem:
    """What is tuned."""
    scenario = Scenario.model_validate(SHORT)
    space, _ = changed_space(default_space([scenario]), [scenario], RANGES, FIXED)
    return Problem("short", (family_of(scenario, None),), (scenario,), (), tuple(space), RaceRules(), SEEDS)


def tuned(folder: Path) -> Path:
    folder.mkdir()
    write_scenario(Scenario.model_validate(SHORT), folder / "short.yaml")
    tune(folder / "short")
    return folder / "short"


def tune_command(kept: Path, out: Path) -> list[str]:
    """What made the folder, once more, with a copy of it."""
    shutil.copytree(kept, out / "short")
    limits = ["--trials", TRIALS, "--seeds", SEEDS, "--validation-seeds", FRESH_SEEDS, "--workers", 1]
    space = [word for field in FIXED for word in ("--fix", field)]
    space += [word for values in RANGES for word in ("--range", values)]
    command = ["tune", kept.with_suffix(".yaml"), *limits, "--no-matters", *space, "--out", out]
    return [str(word) for word in command]


def tune(folder: Path) -> Any:
    """The trials and the validation of ``tune``."""
    folder.mkdir(exist_ok=True)
    trials = search(problem(), f"sqlite:///{folder}/study.db", "short", TRIALS, workers=1)
    flown = fly_candidates(problem().scenarios, candidates_of(problem(), trials), FRESH_SEEDS, folder, 1)
    return trials, [candidate.values.tolist() for candidate in flown]


def half_tuned(whole: Path, folder: Path) -> Path:
    """As a kill leaves a search: trials that ended, one whose process is gone, and one that waits."""
    folder.mkdir()
    study = study_in(folder)
    study.start(problem().first_values)
    missions = tune(whole)[0][0].missions
    for k in range(14):
        trial = study.ask(99)
        later = [mission | {"mission_time_s": mission["mission_time_s"] + k} for mission in missions]
        trial.close(later, Outcomes.of(later, 1), None, None)
    list(run_jobs(ask_and_die, [folder], 1))
    return folder


def ask_and_die(folder: Path) -> None:
    study_in(folder).ask(99)


def study_in(folder: Path) -> TuningStudy:
    return TuningStudy(
        f"sqlite:///{folder}/study.db", "short", problem().as_data(), problem().space, problem().rules, 0
    )


def told_of_run(folder: Path) -> Any:
    """All that results are made from."""
    run = load_run(folder)
    pictures = {path.name: path.read_bytes() for path in run.pictures}
    return dump_scenario(run.scenario), run.records, run.summary, run.seal, run.left_out, pictures


def told_of_sweep(folder: Path) -> Any:
    """What ``report`` makes its statistics from, and what ``sweep`` goes on from."""
    missions = load_missions(str(folder), lambda text: matrix_of(parse_spec(text, "spec.yaml")).table())
    flight = Sweep(parse_spec(SPEC, "spec.yaml"), folder)
    return str(missions.table.to_dicts()), missions.finished, missions.spec, flight.left, flight.errors()


def told_of_comparison(folder: Path) -> Any:
    """What ``report`` makes its statistics from, and what ``compare`` and ``tune`` go on from."""
    summaries = compare(folder)
    runs = sorted((folder / "runs").iterdir())
    drawn = [told_of_run(run.folder) for run in drawn_runs(runs, compare_rows(summaries))]
    return str(load_missions(str(folder)).table.to_dicts()), summaries, drawn


def told_of_tuning(folder: Path) -> Any:
    """What ``tune`` recommends from when it is given again; in a copy, which it may write to."""
    with tempfile.TemporaryDirectory() as copy:
        return tune(shutil.copytree(folder, Path(copy) / "short"))


def told_of_search(folder: Path) -> Any:
    """What ``tune`` tries next, and what it has."""
    with tempfile.TemporaryDirectory() as copy:
        study = study_in(shutil.copytree(folder, Path(copy) / "short"))
        asked = [study.ask(99) for _ in range(2)]
        return study.trials(), [(trial.number, trial.values) for trial in asked]


def kept_in(place: Path, sensor: str) -> dict[str, Kept]:
    """One of each kind of folder."""
    whole, finished = flown(place / "run", sensor), tuned(place / "tuned")
    return {
        "a mission": Kept(whole, told_of_run, 0.3),
        "a mission broken off": Kept(broken_off(whole, place / "broken-off"), told_of_run, 0.15),
        "a sweep": Kept(swept(place / "sweep", True), told_of_sweep, 0.15),
        "a sweep that still runs": Kept(swept(place / "running", False), told_of_sweep, 0.15),
        "a comparison": Kept(compared(place / "comparison"), told_of_comparison, 0.1),
        "a tuning": Kept(finished, told_of_tuning, 0.1, tune_command),
        "a search that was killed": Kept(half_tuned(finished, place / "searched"), told_of_search, 0.05),
    }


@contextmanager
def flipped(path: Path, bit: int) -> Iterator[None]:
    content = path.read_bytes()
    wrong = bytearray(content)
    wrong[bit // 8] ^= 1 << bit % 8
    path.write_bytes(wrong)
    try:
        yield
    finally:
        path.write_bytes(content)


def some_bits(folder: Path, n: int, seed: int) -> Iterator[tuple[Path, int]]:
    """Bits of the folder's files, every other one of a file that is read back."""
    draw = random.Random(seed)
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.stat().st_size)
    read = [p for p in files if p.name in READ_BACK or p.suffix in (".parquet", ".jpg")] or files
    for k in range(n):
        path = draw.choice(read if k % 2 else files)
        yield path, draw.randrange(8 * path.stat().st_size)


def what_happens(kept: Kept, n: int, seed: int) -> Counter[str]:
    """Refused, the same, or WRONG with file and bit, and how often."""
    right, happened = kept.told(kept.folder), Counter[str]()
    for path, bit in some_bits(kept.folder, n, seed):
        with flipped(path, bit):
            try:
                same = kept.told(kept.folder) == right
                happened["the same" if same else f"WRONG: bit {bit} of {path.name}"] += 1
            except UserError:
                happened["refused"] += 1
    return happened


def read_again(kept: Kept, out: Path) -> tuple[int, dict[str, bytes]]:
    """Exit code of the command that reads a folder, and what it writes."""
    shutil.rmtree(out, ignore_errors=True)
    result = CliRunner().invoke(app, kept.command(kept.folder, out))
    assert result.exit_code in (0, 2), result.output
    files = (path for path in out.rglob("*") if path.is_file()) if result.exit_code == 0 else ()
    return result.exit_code, {
        str(path.relative_to(out)): path.read_bytes() for path in files if path.name not in READ_BACK
    }


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Kept]:
    return kept_in(tmp_path_factory.mktemp("kept"), "statistical")


TRIES = {
    "a mission": 60,
    "a mission broken off": 60,
    "a sweep": 60,
    "a sweep that still runs": 60,
    "a comparison": 15,
    "a tuning": 20,
    "a search that was killed": 40,
}


@pytest.mark.parametrize("kind", TRIES)
def test_one_flipped_bit_is_refused_or_changes_nothing(folders, kind):
    happened = what_happens(folders[kind], TRIES[kind], 1)
    assert set(happened) <= {"refused", "the same"}, happened
    assert happened["refused"], "the flips hit nothing that is read"


@pytest.mark.parametrize("kind", list(TRIES)[:-1])
def test_the_command_says_the_same_or_ends_with_exit_code_2(folders, kind, tmp_path):
    kept = folders[kind]
    right = read_again(kept, tmp_path / "out")
    assert right[0] == 0
    for path, bit in some_bits(kept.folder, 2, 2):
        with flipped(path, bit):
            code, files = read_again(kept, tmp_path / "out")
        assert code == 2 or files == right[1], (path, bit)


def main(n: int) -> int:
    with tempfile.TemporaryDirectory() as place:
        wrong = 0
        for kind, kept in kept_in(Path(place), "imaging").items():
            happened = what_happens(kept, round(n * kept.share), 0)
            print(f"{kind}: {dict(happened)}", flush=True)
            wrong += sum(count for what, count in happened.items() if what.startswith("WRONG"))
        print(f"{wrong} of {n} flipped bits gave other numbers")
    return min(wrong, 1)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
