"""The pictures of the camera all along a mission."""

import json
import shutil

import cv2
import numpy as np
import pytest

from skysweep.flights import film
from skysweep.flights.film import PERIOD_S, film_name
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.resume import resume_folder
from skysweep.flights.rig import Rig
from skysweep.scenarios.model import Scenario

SHORT = {
    "name": "short",
    "area": {"polygon_enu_m": [[0, 0], [8, 0], [8, 6], [0, 6]]},
    "home": {"position_enu_m": [-12, -3]},
    "targets": [{"class": "stop sign", "position_enu_m": [4, 3], "size_m": 0.9}],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1, "scan_altitude_agl_m": 8},
}


def fly(folder, film=True, **changes):
    fly_to_folder(Scenario.model_validate(SHORT | changes), 0, folder, Rig(film=film))
    return folder


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    return fly(tmp_path_factory.mktemp("film") / "run")


def looks(folder):
    records = map(json.loads, (folder / "journal.jsonl").read_text().splitlines())
    return [record for record in records if record["kind"] == "look"]


def test_every_look_at_the_usual_rate_has_its_picture(flown):
    assert {p.name for p in (flown / "film").iterdir()} == {film_name(look["t"]) for look in looks(flown)}


def test_a_picture_shows_what_the_detector_saw(flown):
    """The sign is red where the box is, and not beside it."""
    look = max(looks(flown), key=lambda look: max(look["confidences"], default=0.0))
    picture = cv2.imread(str(flown / "film" / film_name(look["t"])))
    assert picture.shape == (360, 640, 3)
    x0, y0, x1, y1 = np.clip(look["boxes_xyxy_px"][int(np.argmax(look["confidences"]))], 0, 640).astype(int)
    _, green, red = cv2.split(picture.astype(int))
    redder = red - green
    assert redder[y0:y1, x0:x1].mean() > np.median(redder) + 20


def test_the_film_leaves_room_for_the_journal(tmp_path, monkeypatch):
    monkeypatch.setattr(film, "_LEFT_FREE_BYTES", 2 * shutil.disk_usage(tmp_path).total)
    folder = fly(tmp_path / "run")
    assert not (folder / "film").exists()
    assert json.loads((folder / "journal.jsonl").read_text().splitlines()[-1])["reason"] == "completed"


def test_looks_more_often_than_the_film_leave_some_out(tmp_path):
    folder = fly(tmp_path / "run", detector={"rate_hz": 10})
    times = sorted(float(p.stem) for p in (folder / "film").iterdir())
    assert len(times) < len(looks(folder)) / 3
    assert np.diff(times).min() >= PERIOD_S - 1e-3


def test_the_film_changes_nothing_in_the_mission(flown, tmp_path):
    plain = fly(tmp_path / "plain", film=False)
    assert not (plain / "film").exists()
    assert (plain / "journal.jsonl").read_bytes() == (flown / "journal.jsonl").read_bytes()


def test_a_resumed_mission_has_the_same_film(flown, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(flown, broken)
    journal = broken / "journal.jsonl"
    data = journal.read_bytes()
    journal.write_bytes(data[: len(data) // 2])
    last_s = json.loads(journal.read_bytes().splitlines()[-2])["t"]
    for name in ("summary.json", "report.html"):
        (broken / name).unlink()
    for picture in (broken / "film").iterdir():
        if float(picture.stem) > last_s:
            picture.unlink()
    before = {p.name: p.stat().st_mtime_ns for p in (broken / "film").iterdir()}
    resume_folder(broken, Rig(film=True))
    after = {p.name: p.stat().st_mtime_ns for p in (broken / "film").iterdir()}
    assert before.items() <= after.items()
    assert set(after) == {p.name for p in (flown / "film").iterdir()}
    assert all(
        (flown / "film" / name).read_bytes() == (broken / "film" / name).read_bytes() for name in after
    )


def test_a_film_that_cannot_be_written_costs_the_picture_not_the_mission(tmp_path, monkeypatch):
    from skysweep.flights import film

    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(film, "write_picture", full)
    folder = fly(tmp_path / "run")
    assert list((folder / "film").iterdir()) == []
    assert json.loads((folder / "summary.json").read_text())["completed"]
