from __future__ import annotations

import cv2
import numpy as np
import pytest
from results_data import tiny_records, write_run

from skysweep.results.metrics import seen_area
from skysweep.results.picture_files import write_picture
from skysweep.results.run_folder import FILM, load_run
from skysweep.results.video import pen
from skysweep.results.video.chart import Chart
from skysweep.results.video.chase import Chase
from skysweep.results.video.eye import Eye
from skysweep.results.video.story import Story
from skysweep.worlds.obstacles import Obstacles
from skysweep.worlds.rendering.renderer import make_renderer

SIZE = 400, 300
RENDERED = "Detector's view, rendered from the believed pose"


@pytest.fixture
def story(tiny_run):
    return Story(tiny_run, speed=10.0, fps=10)


@pytest.fixture
def painter(tiny_run):
    painter = make_renderer(tiny_run.world)
    yield painter
    painter.close()


def at(story, time_s):
    return story.moment(int(np.argmin(np.abs(story.times_s - time_s))))


def test_map_is_to_scale_and_north_is_up(story):
    chart = Chart(story, *SIZE, "auto")
    west, south, east, north = chart.bounds_enu_m
    assert (east - west) / (north - south) == pytest.approx(SIZE[0] / SIZE[1])
    (corner, opposite) = chart.pixels(np.array([[west, north], [east, south]]))
    assert corner == pytest.approx([0, 0])
    assert opposite == pytest.approx(SIZE)


def test_vehicle_is_on_the_map_where_it_flies(story):
    chart = Chart(story, *SIZE, "auto")
    for time_s in (10, 15, 35):
        moment = at(story, time_s)
        picture, _ = chart.draw(moment, 1.0)
        x, y = chart.pixels(moment.position_enu_m[None, :2])[0].astype(int)
        assert picture[y - 1 : y + 2, x - 1 : x + 2].min() > 200


def test_ground_lightens_as_the_camera_sees_it(story):
    chart = Chart(story, *SIZE, "auto")
    shares = []
    for time_s in (0, 10, 15, 35, 80):
        chart.draw(at(story, time_s), 1.0)
        shares.append(chart.seen_share)
    assert shares[0] == 0
    assert shares == sorted(shares)
    run = story.run
    assert shares[-1] == pytest.approx(seen_area(run).area / run.scenario.area_enu_m.area, abs=0.02)


def test_map_marks_candidates_by_their_standing(story):
    chart = Chart(story, *SIZE, "auto")
    x, y = chart.pixels(np.array([[28.0, 4.0]]))[0].astype(int)
    before = chart.draw(at(story, 49), 1.0)[0][y, x]
    after = chart.draw(at(story, 51), 1.0)[0][y, x]
    assert after.tolist() == pytest.approx([0, 158, 115], abs=2)
    assert before.tolist() != after.tolist()


def test_chase_shows_vehicle_and_what_it_looks_at(story, painter):
    """The vehicle is in the upper middle; its camera's picture lies below it."""
    chase = Chase(story, painter, *SIZE)
    moment = at(story, 33)
    picture, _ = chase.draw(moment, 1.0)
    plain = painter.render(chase._lens, chase._pose(moment, np.radians(17.0)), moment.time_s)
    rows, columns = np.nonzero(np.abs(picture.astype(int) - plain).max(axis=2) > 100)
    assert len(rows) > 50
    dark = picture.max(axis=2) < 60
    rows, columns = np.nonzero(dark & (plain.max(axis=2) >= 60))
    assert columns.mean() == pytest.approx(SIZE[0] / 2, abs=12)
    assert 0.1 * SIZE[1] < rows.mean() < 0.5 * SIZE[1]


def look(t):
    box = {"boxes_xyxy_px": [[160, 80, 320, 240]], "confidences": [0.7], "class_names": ["stop sign"]}
    return {"t": t, "kind": "look"} | box


@pytest.fixture
def filmed(tmp_path):
    records = sorted([*tiny_records(), look(12.0), look(14.0)], key=lambda record: record["t"])
    folder = write_run(tmp_path / "run", records)
    (folder / FILM).mkdir()
    blue = np.zeros((320, 640, 3), np.uint8)
    blue[..., 0] = 200
    write_picture(folder / FILM / "12.0000.jpg", cv2.imencode(".jpg", blue)[1].tobytes())
    return Story(load_run(folder), 10.0, 10)


def test_the_film_is_shown_with_the_boxes_of_its_look(filmed, painter):
    eye = Eye(filmed, painter, 320, 240)
    picture, labels, title = eye.draw(at(filmed, 12.5), 1.0)
    assert title == "Detector's camera"
    assert picture.shape == (160, 320, 3)
    assert picture[20, 20].tolist() == pytest.approx([0, 0, 200], abs=6)
    assert picture[80, 80].tolist() == pytest.approx([230, 159, 0], abs=6)  # left edge of the box
    assert [label.text for label in labels] == ["stop sign 0.70"]
    _, labels, title = eye.draw(at(filmed, 30), 1.0)  # long after it
    assert (labels, title) == ([], RENDERED)


@pytest.mark.parametrize("box", [[0, 0, 30, 30], [600, 0, 640, 40], [600, 290, 640, 320], [-5, 280, 20, 330]])
def test_labels_of_boxes_at_the_edge_stay_in_the_view(box, tmp_path, painter):
    records = sorted([*tiny_records(), look(12.0) | {"boxes_xyxy_px": [box]}], key=lambda r: r["t"])
    story = Story(load_run(write_run(tmp_path / "run", records)), 10.0, 10)
    picture, labels, _ = Eye(story, painter, 400, 300).draw(at(story, 12.5), 1.0)
    wide = np.zeros((600, 800, 3), np.uint8)
    drawn = pen.write(
        wide, [label._replace(x_px=label.x_px + 200, y_px=label.y_px + 200) for label in labels]
    )
    rows, columns = np.nonzero(drawn.max(axis=2))
    height, width = picture.shape[:2]
    assert 200 <= columns.min() < columns.max() <= 200 + width
    assert 200 <= rows.min() < rows.max() <= 200 + height


@pytest.mark.parametrize("is_there", [False, True])
def test_without_film_the_scenario_is_rendered_and_the_title_says_so(filmed, painter, is_there):
    path = filmed.run.folder / FILM / "12.0000.jpg"
    damaged = path.read_bytes()[:-40]
    path.unlink()
    if is_there:
        path.write_bytes(damaged)
    eye = Eye(filmed, painter, 320, 240)
    picture, labels, title = eye.draw(at(filmed, 12.5), 1.0)
    assert title == RENDERED
    assert picture[20, 20, 1] > picture[20, 20, 2]  # grass
    assert len(labels) == 1


def test_a_sensor_without_pictures_shows_what_it_reported(story, painter):
    eye = Eye(story, painter, 320, 240)
    _, labels, title = eye.draw(at(story, 11), 1.0)
    assert "took no pictures" in title
    assert [label.text for label in labels] == ["0.40"]
    assert eye.draw(at(story, 25), 1.0)[1] == []


def test_chase_looks_down_past_a_building(tmp_path, painter):
    """On its way east the vehicle comes from behind a building: the view from behind rises above it."""
    building = {"position_enu_m": [-20.0, 10.0], "size_m": [10.0, 16.0], "height_m": 14.0}
    run = load_run(write_run(tmp_path / "run", tiny_records(), buildings=[building]))
    story = Story(run, speed=10.0, fps=10)
    chase = Chase(story, painter, *SIZE)
    obstacles = Obstacles(run.world.terrain, run.world.trees, run.world.buildings)
    steepest, elevations = 0.0, []
    for k in range(len(story)):
        moment = story.moment(k)
        elevations.append(chase._elevation_rad[k])
        eye = chase._pose(moment, elevations[-1]).position_enu_m
        assert not obstacles.hide(moment.position_enu_m, eye)
        steepest = max(steepest, elevations[-1])
    assert steepest > np.radians(30)
    assert min(elevations) == pytest.approx(np.radians(17))
    assert np.abs(np.diff(elevations)).max() < np.radians(10)
