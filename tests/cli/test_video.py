"""'skysweep video' on the run folder of a real mission."""

import shutil

import av
import pytest
from PIL import Image
from typer.testing import CliRunner

from skysweep.cli import app

SCENARIO = """
name: small
area: {polygon_enu_m: [[0, 0], [60, 0], [60, 40], [0, 40]]}
targets:
  - {class: stop sign, position_enu_m: [30, 20]}
"""
SMALL = ["--speed", "60", "--fps", "4", "--size", "320x180"]


def skysweep(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    (folder / "small.yaml").write_text(SCENARIO)
    run = folder / "run"
    result = skysweep("run", folder / "small.yaml", "--sensor", "statistical", "--out", run)
    assert result.exit_code == 0, result.stderr
    return run


@pytest.fixture
def run_folder(flown, tmp_path):
    return shutil.copytree(flown, tmp_path / "run")


def test_the_video_lies_in_the_run_folder(run_folder):
    result = skysweep("video", run_folder, *SMALL)
    assert result.exit_code == 0, result.stderr
    assert result.stdout == f"video: {run_folder / 'mission.mp4'}\n"
    with av.open(str(run_folder / "mission.mp4")) as file:
        assert (file.streams.video[0].width, file.streams.video[0].height) == (320, 180)


def test_an_animation_for_a_page(run_folder, tmp_path):
    result = skysweep("video", run_folder, *SMALL, "--out", tmp_path / "new" / "mission.webp")
    assert result.exit_code == 0, result.stderr
    with Image.open(tmp_path / "new" / "mission.webp") as image:
        assert image.is_animated


def test_a_mission_that_broke_off_is_shown_so_far_with_a_warning(run_folder):
    lines = (run_folder / "journal.jsonl").read_text().splitlines(keepends=True)
    (run_folder / "journal.jsonl").write_text("".join(lines[: len(lines) // 3]))
    (run_folder / "summary.json").unlink()
    result = skysweep("video", run_folder, *SMALL)
    assert result.exit_code == 0, result.stderr
    assert "the video shows it so far" in result.stderr
    assert (run_folder / "mission.mp4").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size", "big"], "write WIDTHxHEIGHT"),
        (["--size", "321x180"], "even numbers"),
        (["--out", "movie.avi"], "end it with .mp4"),
    ],
)
def test_one_sentence_says_what_is_wrong(arguments, words, run_folder):
    result = skysweep("video", run_folder, *arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert "Traceback" not in result.stderr


def test_another_folder_is_refused(tmp_path):
    result = skysweep("video", tmp_path, *SMALL)
    assert result.exit_code == 2
    assert "give a folder that 'skysweep run' wrote" in result.stderr
    assert not any(tmp_path.iterdir())
