"""A mission over files that have changed is neither resumed nor reported as if they had not."""

import shutil

import numpy as np
import pytest
from tests.worlds.geotiffs import over, placed, slope, write

from skysweep.errors import UserError
from skysweep.experiments.matrix import Matrix
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.results.run_folder import load_flown
from skysweep.scenarios.files import load_scenario

SIZE = (60, 60)
AREA = [[0, 0], [60, 0], [60, 40], [0, 40]]


def scenario(dem):
    generators = [{"class": "person", "pattern": "uniform", "count": 2}]
    return over(area=AREA, dem=dem, others={"generators": generators, "camera": {"hfov_rad": 1.2}})


@pytest.fixture()
def dem(tmp_path):
    return write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE, middle_enu_m=(0, 0)))


def test_resume_and_report_want_the_files_that_were_flown_over(tmp_path, dem, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flown = scenario("dem.tif")
    whole = fly_to_folder(flown, 1, tmp_path / "run", Rig("statistical"))
    run = tmp_path / "run"
    assert load_scenario(run / "config.yaml").terrain.dem == str(dem), "found from anywhere"
    half = tmp_path / "half"
    half.mkdir()
    shutil.copy(run / "config.yaml", half)
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (half / "journal.jsonl").write_bytes(b"".join(lines[: len(lines) // 2]))
    before = (half / "journal.jsonl").read_bytes()
    write(dem, slope(SIZE) + np.float32(1.0) * np.arange(60), transform=placed(10.0, SIZE, middle_enu_m=(0, 0)))
    with pytest.raises(UserError, match=r"begun with ground [0-9a-f]{64}, and now it is [0-9a-f]{64}; put back"):
        resume_folder(half)
    assert (half / "journal.jsonl").read_bytes() == before
    with pytest.raises(UserError, match=r"dem\.tif: are not the files of the ground that the mission was flown"):
        _ = load_flown(run).world
    write(dem, slope(SIZE), transform=placed(10.0, SIZE, middle_enu_m=(0, 0)))
    assert resume_folder(half)["mission_time_s"] == whole["mission_time_s"]
    assert load_flown(run).world.targets


def test_missions_over_other_ground_have_other_keys(dem):
    def key():
        return Matrix.of([("x", scenario(dem))], [0], "statistical", []).jobs()[0].config_hash

    first = key()
    assert key() == first
    write(dem, 2 * slope(SIZE), transform=placed(10.0, SIZE, middle_enu_m=(0, 0)))
    assert key() != first
