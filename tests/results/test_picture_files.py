"""A picture kept in flight is one that any program shows, and no damage to it goes unseen."""

import os

import cv2
import numpy as np
import pytest

from skysweep.errors import UserError
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.results.picture_files import read_picture, write_picture
from skysweep.results.run_folder import load_run
from skysweep.scenarios.model import Scenario

IMAGE = np.random.default_rng(0).integers(0, 255, (9, 16, 3), dtype=np.uint8)
JPEG = cv2.imencode(".jpg", IMAGE)[1].tobytes()
NAME = "candidate-7-133.4s.jpg"
SMALL = {
    "name": "small",
    "area": {"polygon_enu_m": [[0, 0], [8, 0], [8, 6], [0, 6]]},
    "home": {"position_enu_m": [-5, -3]},
    "camera": {"hfov_rad": 1.2},
    "search": {"scan_altitude_agl_m": 8},
}


def test_a_pipe_in_place_of_a_picture_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / NAME)
    assert read_picture(tmp_path / NAME) is None


def test_it_shows_what_was_kept(tmp_path):
    write_picture(tmp_path / NAME, JPEG)
    assert [path.name for path in tmp_path.iterdir()] == [NAME]
    assert read_picture(tmp_path / NAME) == (tmp_path / NAME).read_bytes()
    assert (cv2.imread(str(tmp_path / NAME)) == cv2.imdecode(np.frombuffer(JPEG, np.uint8), 1)).all()


def test_bits_everywhere_and_the_name_count(tmp_path):
    path = tmp_path / NAME
    write_picture(path, JPEG)
    content = path.read_bytes()
    for bit in range(0, 8 * len(content), 11):
        wrong = bytearray(content)
        wrong[bit // 8] ^= 1 << bit % 8
        path.write_bytes(wrong)
        assert read_picture(path) is None, bit
    for wrong in (b"", content[:-1], content + b"\0", JPEG):
        path.write_bytes(wrong)
        assert read_picture(path) is None
    other = tmp_path / "candidate-8-133.4s.jpg"
    other.write_bytes(content)
    assert read_picture(other) is None


def test_a_damaged_picture_is_named_and_left_out_when_asked_for(tmp_path):
    fly_to_folder(Scenario.model_validate(SMALL), 0, tmp_path, Rig("statistical"))
    (tmp_path / "pictures").mkdir()
    for name in (NAME, "candidate-8-140.0s.jpg"):
        write_picture(tmp_path / "pictures" / name, JPEG)
    assert len(load_run(tmp_path).pictures) == 2
    (tmp_path / "pictures" / NAME).write_bytes(JPEG)
    with pytest.raises(UserError, match=r"pictures/candidate-7-133\.4s\.jpg: is damaged; delete it"):
        load_run(tmp_path)
    run = load_run(tmp_path, from_sound_lines=True)
    assert run.left_out == (f"pictures/{NAME}",)
    assert [path.name for path in run.pictures] == ["candidate-8-140.0s.jpg"]
