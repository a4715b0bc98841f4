from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import pytest
from PIL import Image
from results_data import tiny_records, write_run

from skysweep.errors import MissingExtraError, UserError
from skysweep.results.run_folder import load_run
from skysweep.results.video.chart import Chart
from skysweep.results.video.encode import encode
from skysweep.results.video.make import write_video
from skysweep.results.video.page import Layout
from skysweep.results.video.pen import rgb
from skysweep.results.video.story import STANDING_COLOURS, Story, mode_colour
from skysweep.types import Mode

SMALL = 320, 180


def decoded(path):
    with av.open(str(path)) as file:
        return [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]


def test_mp4_is_what_browsers_play(tiny_run, tmp_path):
    told = []
    path = write_video(tiny_run, tmp_path / "v.mp4", 40.0, SMALL, 5, lambda done, of: told.append((done, of)))
    with av.open(str(path)) as file:
        (stream,) = file.streams
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate) == (*SMALL, Fraction(5))
        assert float(stream.duration * stream.time_base) == pytest.approx(80 / 40 + 2, abs=0.25)
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")
    frames = decoded(path)
    assert [done for done, _ in told] == list(range(1, len(frames) + 1))
    assert {of for _, of in told} == {len(frames)}
    for frame in frames:
        assert frame.shape == (180, 320, 3)
        for room in Layout.of(*SMALL)[:3]:
            shown = frame[room.top : room.top + room.height, room.left : room.left + room.width]
            assert 15 < shown.mean() < 230
            assert shown.std() > 5


def test_vehicle_on_the_map_of_the_decoded_video_is_where_it_flew(tiny_run, tmp_path):
    """At 35 s it is at (20, 10): the arrow is white there, and nowhere else on its path at that time."""
    size, speed, fps = (1280, 720), 17.5, 1
    frames = decoded(write_video(tiny_run, tmp_path / "v.mp4", speed, size, fps))
    story = Story(tiny_run, speed, fps)
    room = Layout.of(*size).map
    chart = Chart(story, room.width, room.height, "auto")

    def brightness(frame, xy):
        x, y = np.round(chart.pixels(np.array([xy]))[0] + np.array(room[:2])).astype(int)
        return frame[y - 1 : y + 2, x - 1 : x + 2].mean()

    assert story.times_s[2] == 35
    assert brightness(frames[2], story.moment(2).position_enu_m[:2]) > 200
    assert brightness(frames[0], story.moment(2).position_enu_m[:2]) < 170
    assert brightness(frames[2], (30.0, 15.0)) < 170


def test_same_run_gives_the_same_frames(tiny_run, tmp_path):
    one, two = (
        decoded(write_video(tiny_run, tmp_path / name, 80.0, SMALL, 2)) for name in ("1.mp4", "2.mp4")
    )
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("name", ["v.gif", "v.webp"])
def test_animations(name, tiny_run, tmp_path):
    path = write_video(tiny_run, tmp_path / name, 80.0, SMALL, 4)
    with Image.open(path) as image:
        assert image.size == SMALL
        assert image.is_animated
        assert image.info["loop"] == 0
        assert np.asarray(image.convert("RGB")).std() > 20


@pytest.mark.parametrize(("name", "unit_ms"), [("v.gif", 10), ("v.webp", 1)])
def test_an_animation_lasts_as_long_as_its_frames(name, unit_ms, tiny_run, tmp_path):
    path = write_video(tiny_run, tmp_path / name, 40.0, SMALL, 15)
    with Image.open(path) as image:
        lasts_ms = 0
        for k in range(image.n_frames):
            image.seek(k)
            image.load()
            lasts_ms += image.info["duration"]
    assert lasts_ms == pytest.approx(1000 * len(Story(tiny_run, 40.0, 15)) / 15, abs=unit_ms)


def test_a_gif_keeps_colours_that_its_first_frame_lacks(tmp_path):
    rng = np.random.default_rng(0)
    meadow = (np.array([70, 90, 40]) + rng.integers(-30, 30, (180, 320, 1))).astype(np.uint8)
    colours = sorted({mode_colour(mode) for mode in Mode} | {rgb(c) for c in STANDING_COLOURS.values()})
    marked = meadow.copy()
    for k, colour in enumerate(colours):
        marked[20 * k + 5, 10:60] = colour
    encode([meadow, marked], 2, tmp_path / "v.gif", 10, 320, 180)
    with Image.open(tmp_path / "v.gif") as image:
        image.seek(1)
        shown = np.asarray(image.convert("RGB")).astype(int)
    for k, colour in enumerate(colours):
        assert np.abs(shown[20 * k + 5, 10:60] - colour).max() <= 8


def test_a_mission_that_flies_or_broke_off_is_shown_so_far(tmp_path):
    run = load_run(write_run(tmp_path / "run", tiny_records()[:12]))
    assert len(decoded(write_video(run, tmp_path / "v.mp4", 17.0, SMALL, 2))) == 2 + 1 + 4


@pytest.mark.parametrize(
    ("name", "size", "speed", "words"),
    [
        ("v.avi", SMALL, 10.0, "end it with .mp4"),
        ("v.mp4", (321, 180), 10.0, "--size 321x180: write even numbers"),
        ("v.mp4", (100, 100), 10.0, "320x180"),
        ("v.mp4", (9000, 180), 10.0, "3840x2160"),
        ("v.mp4", SMALL, 1e-3, "write a greater speed"),
    ],
)
def test_what_cannot_be_made_is_refused_and_nothing_is_written(name, size, speed, words, tiny_run, tmp_path):
    with pytest.raises(UserError, match=words):
        write_video(tiny_run, tmp_path / "out" / name, speed, size, 15)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "fps", "words"),
    [("v.gif", 51, "--fps 51: is too fast for a GIF; write at most 50"), ("folder.mp4", 15, "is a folder")],
)
def test_what_cannot_be_written_is_refused_before_a_frame_is_drawn(name, fps, words, tiny_run, tmp_path):
    def drawn(done, of):
        raise AssertionError

    (tmp_path / "folder.mp4").mkdir()
    with pytest.raises(UserError, match=words):
        write_video(tiny_run, tmp_path / name, 40.0, SMALL, fps, drawn)


def test_without_pyav_the_extra_is_named(tiny_run, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    with pytest.raises(MissingExtraError, match=r"install it with  tools/setup\.sh video"):
        write_video(tiny_run, tmp_path / "v.mp4")
