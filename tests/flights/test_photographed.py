import csv
import json
import math
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import skysweep as ss
from skysweep.cli import app
from skysweep.detection.yolo import YoloDetector
from skysweep.errors import UserError
from skysweep.flights.photographed.places import pose_of, scenario_of
from skysweep.flights.photographed.run import Options, look_at_flight
from skysweep.flights.photographed.shots import shots_of
from skysweep.geometry.camera import Lens, project
from skysweep.geometry.frames import LocalFrame
from skysweep.results.run_folder import load_run
from skysweep.tracking.georeference import pixels_to_ground
from skysweep.worlds.world import build_world

sys.path.insert(0, str(Path(__file__).parents[1] / "detection"))
from drone_pictures import dji, jpeg

HOME = 60.45, 22.29
SIGN = np.array([12.0, 9.0, 0.0])
FOCAL_35_MM = 28.0
SIZE_PX = 640, 480


def world_with_a_sign():
    scenario = {
        "name": "field",
        "area": {"polygon_enu_m": [[-40, -40], [60, -40], [60, 60], [-40, 60]]},
        "home": {"latitude_deg": HOME[0], "longitude_deg": HOME[1]},
        "targets": [{"class": "stop sign", "position_enu_m": SIGN[:2].tolist(), "size_m": 0.9}],
        "camera": {"width_px": SIZE_PX[0], "height_px": SIZE_PX[1], "hfov_rad": hfov_rad()},
    }
    return ss.build_world(ss.Scenario.model_validate(scenario), seed=0)


def hfov_rad():
    focal_px = FOCAL_35_MM / math.hypot(36, 24) * math.hypot(*SIZE_PX)
    return 2 * math.atan(SIZE_PX[0] / 2 / focal_px)


def shot_from(world, folder, name, position, heading_deg, pitch_deg, image=None):
    """Render a view and write it as a DJI's picture."""
    pose = ss.camera_pose(position, heading_deg=heading_deg, pitch_deg=pitch_deg)
    latitude, longitude, _ = LocalFrame(*HOME).geodetic_from_enu(position)[0]
    xmp = dji(heading_deg, pitch_deg, position[2], latitude, longitude)
    image = world.render(pose) if image is None else image
    taken = f"2024:05:01 10:00:{len(list(folder.iterdir())):02d}"
    (folder / name).write_bytes(jpeg(image, xmp, make="DJI", focal_35_mm=FOCAL_35_MM, taken=taken))
    return pose


def test_a_rendered_sign_is_found_within_metres(tmp_path):
    """From above and aslant, as report, exports and pictures tell it; broken pictures are named."""
    folder, out = tmp_path / "flight", tmp_path / "out"
    folder.mkdir()
    world = world_with_a_sign()
    shot_from(world, folder, "a.jpg", (10.0, 8.0, 12.0), 30.0, -90.0)
    shot_from(world, folder, "b.jpg", (6.0, 3.0, 10.0), 45.0, -60.0)
    (folder / "broken.jpg").write_bytes(b"\xff\xd8 no picture")
    (folder / "phone.jpg").write_bytes(jpeg(np.full((480, 640, 3), 90, np.uint8)))
    whole = (folder / "b.jpg").read_bytes()
    (folder / "cut.jpg").write_bytes(whole[: len(whole) // 3])
    looked = look_at_flight(folder, out, Options(confidence_min=0.4))
    assert looked.n_candidates == 1
    assert {p.name: p.why.split(";")[0] for p in looked.left_out} == {
        "cut.jpg": "is damaged",
        "broken.jpg": "is no readable picture",
        "phone.jpg": "does not say where it was taken",
    }
    (feature,) = json.loads((out / "targets.geojson").read_text())["features"]
    longitude, latitude = feature["geometry"]["coordinates"]
    found = LocalFrame(*HOME).enu_from_geodetic([(latitude, longitude, 0.0)])[0]
    assert np.hypot(*(found - SIGN)[:2]) < 1.5
    told = feature["properties"]
    assert (told["class_name"], told["status"], told["picture"][:18]) == (
        "stop sign",
        "unchecked",
        "pictures/candidate",
    )
    for name in ("targets.kml", "targets.gpx", "targets.csv", "map.png", "report.html"):
        assert (out / name).stat().st_size > 200
    page = (out / "report.html").read_text()
    assert "phone.jpg" in page
    assert "have a look" in page
    assert load_run(out).ended


@settings(max_examples=60)
@given(
    heading_deg=st.floats(-180, 180),
    pitch_deg=st.floats(-90, -35),
    height_m=st.floats(5, 120),
    east_m=st.floats(-500, 500),
    south=st.booleans(),
)
def test_a_place_in_a_picture_is_the_place_on_the_ground(
    tmp_path_factory, heading_deg, pitch_deg, height_m, east_m, south
):
    """What the project's camera shows at a pixel lies, by the EXIF and XMP written for it, at that place."""
    folder = tmp_path_factory.mktemp("flight")
    frame = LocalFrame(-33.9 if south else 69.6, 151.2)
    position = np.array([east_m, 20.0, height_m])
    pose = ss.camera_pose(position, heading_deg=heading_deg, pitch_deg=pitch_deg)
    latitude, longitude, _ = frame.geodetic_from_enu(position)[0]
    xmp = dji(heading_deg, pitch_deg, height_m, latitude, longitude)
    (folder / "a.jpg").write_bytes(jpeg(np.full((72, 96, 3), 90, np.uint8), xmp, focal_35_mm=FOCAL_35_MM))
    shots, _ = shots_of(folder, None, None, 1.0, has_dem=False)
    scenario = scenario_of(shots, "flight", {}, None)
    world = build_world(scenario, 0)
    seen = pose_of(shots[0], scenario, world)
    pixel = np.array([[75.0, 45.0]])
    flat = lambda xy: np.zeros(len(xy))  # noqa: E731
    true = pixels_to_ground(Lens(96, 72, shots[0].lens.hfov_rad), pose, pixel, flat)
    found = pixels_to_ground(shots[0].lens, seen, pixel, world.terrain.height_m)
    geodetic = scenario.frame.geodetic_from_enu(found)
    back = frame.enu_from_geodetic(np.column_stack([geodetic[:, :2], np.zeros(1)]))
    assert np.hypot(*(back - true)[0, :2]) < 0.02 * height_m + 0.1
    assert scenario.area_enu_m.buffer(0.5).covers(shapely.Point(*found[0, :2]))
    assert project(shots[0].lens, seen, found)[1][0] > 0


def test_hills_count_where_they_are_known(tmp_path):
    """Ground that rises by 0.2 to the east: the second picture, 30 m above take-off, is 18 m above it."""
    rasterio = pytest.importorskip("rasterio")
    folder, dem = tmp_path / "flight", tmp_path / "dem.tif"
    folder.mkdir()
    grey = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    for k, east_m in enumerate((0.0, 60.0)):
        shot_from(None, folder, f"{k}.jpg", (east_m, 0.0, 30.0), 0.0, -90.0, grey)
    place = rasterio.Affine(1e-4, 0, HOME[1] - 0.02, 0, -5e-5, HOME[0] + 0.01)
    longitudes = HOME[1] - 0.02 + 1e-4 * (np.arange(400) + 0.5)
    east_m = LocalFrame(*HOME).enu_from_geodetic([(HOME[0], x, 0.0) for x in longitudes])[:, 0]
    fields = {"driver": "GTiff", "dtype": "float32", "count": 1, "crs": "EPSG:4326", "transform": place}
    with rasterio.open(dem, "w", width=400, height=400, **fields) as file:
        file.write(np.tile(100.0 + 0.2 * east_m, (400, 1)).astype(np.float32), 1)
    shots, _ = shots_of(folder, None, None, 1.0, has_dem=True)
    scenario = scenario_of(shots, "flight", {}, dem)
    world = build_world(scenario, 0)
    lens, pose = shots[1].lens, pose_of(shots[1], scenario, world)
    pixel = np.array([[SIZE_PX[0] / 2 + 0.5 * lens.focal_px, SIZE_PX[1] / 2]])  # 0.5 east for each metre down
    found = pixels_to_ground(lens, pose, pixel, world.terrain.height_m)[0]
    # x = 60 + 0.5 (30 - 0.2 x)
    np.testing.assert_allclose(found, [75 / 1.1, 0.0, 15 / 1.1], atol=0.5)
    assert look_at_flight(folder, tmp_path / "out", Options(dem=dem)).n_pictures == 2


def test_the_same_command_goes_on_and_another_one_is_refused(tmp_path, monkeypatch):
    folder, out = tmp_path / "flight", tmp_path / "out"
    folder.mkdir()
    grey = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    for k in range(3):
        shot_from(None, folder, f"{k}.jpg", (0.0, 5.0 * k, 20.0), 0.0, -90.0, grey)
    done = []

    def stop(n, total):
        done.append(n)
        if len(done) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        look_at_flight(folder, out, Options(), stop)
    looks = []
    real = YoloDetector.detect
    monkeypatch.setattr(YoloDetector, "detect", lambda self, frame: looks.append(1) or real(self, frame))
    assert look_at_flight(folder, out, Options()).n_pictures == 3
    assert len(looks) == 1
    assert load_run(out).summary["n_unchecked"] == 0
    with pytest.raises(UserError, match="was begun with other pictures, another detector"):
        look_at_flight(folder, out, Options(confidence_min=0.5))


@pytest.mark.parametrize("kept", ["journal.jsonl", "pictures/holiday.jpg"])
def test_a_folder_that_holds_something_else_is_left_as_it_is(kept, tmp_path):
    folder, out = tmp_path / "flight", tmp_path / "out"
    folder.mkdir()
    shot_from(None, folder, "0.jpg", (0, 0, 20), 0, -90, np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8))
    (out / kept).parent.mkdir(parents=True)
    (out / kept).write_text("mine")
    with pytest.raises(UserError, match="holds something else; write a new folder"):
        look_at_flight(folder, out, Options())
    assert [p.read_text() for p in out.rglob("*") if p.is_file()] == ["mine"]


@pytest.mark.parametrize(("source", "out"), [("a", "a"), ("a/pictures", "a"), ("a", "a/out")])
def test_pictures_and_results_have_folders_of_their_own(source, out, tmp_path):
    (tmp_path / source).mkdir(parents=True)
    with pytest.raises(UserError, match="write a folder apart from"):
        look_at_flight(tmp_path / source, tmp_path / out, Options())


def test_pictures_of_the_same_name_are_other_pictures(tmp_path):
    """Every card of a drone begins with DJI_0001.jpg."""
    world = world_with_a_sign()
    grey = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    first, second, out = tmp_path / "first", tmp_path / "second", tmp_path / "out"
    for folder, image in ((first, grey), (second, None)):
        folder.mkdir()
        shot_from(world, folder, "DJI_0001.jpg", (12.0, 9.0, 12.0), 0.0, -90.0, image)
    assert look_at_flight(first, out, Options()).n_candidates == 0
    with pytest.raises(UserError, match="was begun with other pictures"):
        look_at_flight(second, out, Options())
    (first / "DJI_0001.jpg").write_bytes((second / "DJI_0001.jpg").read_bytes())
    assert look_at_flight(first, out, Options()).n_candidates == 1


def test_deep_pixels_are_left_out_by_name(tmp_path):
    """A detector would be shown white only."""
    folder = tmp_path / "flight"
    folder.mkdir()
    grey = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    shot_from(None, folder, "a.jpg", (0.0, 0.0, 20.0), 0.0, -90.0, grey)
    cv2.imwrite(str(folder / "b.png"), np.full(SIZE_PX[::-1], 20_000, np.uint16))
    table = tmp_path / "poses.csv"
    table.write_text(
        "file,latitude_deg,longitude_deg,height_m,heading_deg,pitch_deg,hfov_deg\n"
        f"b.png,{HOME[0]},{HOME[1]},20,0,-90,60\n"
    )
    looked = look_at_flight(folder, tmp_path / "out", Options(poses=table))
    assert [(p.name, p.why.split(";")[0]) for p in looked.left_out] == [
        ("b.png", "has more than 8 bits a channel")
    ]


def test_detections_of_the_wrong_size_are_counted(tmp_path):
    """From 100 m the sign's picture spans 9 m on the ground."""
    folder, out = tmp_path / "flight", tmp_path / "out"
    folder.mkdir()
    image = world_with_a_sign().render(ss.camera_pose((12.0, 9.0, 10.0), heading_deg=0, pitch_deg=-90))
    shot_from(None, folder, "a.jpg", (0.0, 0.0, 100.0), 0.0, -90.0, image)
    told = CliRunner().invoke(app, ["detect", "run", str(folder), "--out", str(out), "--find", "stop sign"])
    assert "candidates: 0, pictures: 1" in told.output
    sentence = "1 detection left out: too large or small on the ground"
    assert sentence in told.output
    page = (out / "report.html").read_text()
    assert sentence in page
    assert "The detector reported nothing" not in page


def test_a_video_with_poses(tmp_path):
    path, out = tmp_path / "flight.mp4", tmp_path / "out"
    world = world_with_a_sign()
    image = world.render(ss.camera_pose((12.0, 9.0, 10.0), heading_deg=0, pitch_deg=-90))
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 5.0, SIZE_PX)
    for _ in range(15):
        video.write(image[..., ::-1])
    video.release()
    latitude, longitude, _ = LocalFrame(*HOME).geodetic_from_enu([(12.0, 9.0, 0.0)])[0]
    with (tmp_path / "poses.csv").open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time_s", "latitude_deg", "longitude_deg", "height_m", "heading_deg", "pitch_deg"])
        for time_s in (0.5, 10.0):
            rows.writerow([time_s, latitude, longitude, 10.0, 0.0, -90.0])
    options = Options(poses=tmp_path / "poses.csv", hfov_deg=math.degrees(hfov_rad()), confidence_min=0.4)
    looked = look_at_flight(path, out, options)
    assert (looked.n_pictures, looked.n_candidates) == (2, 1)  # at 1 and 2 s; nothing is known of 0 s
    with pytest.raises(UserError, match="a video does not say where it was taken"):
        look_at_flight(path, tmp_path / "other", Options())


def test_a_picture_of_the_sky_is_left_out(tmp_path):
    grey = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    for name, pitch_deg in (("down.jpg", -90.0), ("up.jpg", 90.0)):
        shot_from(None, tmp_path, name, (0.0, 0.0, 20.0), 0.0, pitch_deg, grey)
    shots, ((name, why),) = shots_of(tmp_path, None, None, 1.0, has_dem=False)
    assert ([shot.name for shot in shots], name) == (["down.jpg"], "up.jpg")
    assert why.startswith("shows no ground, as its camera looks up (pitch_deg 90;")


def test_a_picture_of_an_earlier_flight_is_left_out(tmp_path):
    """Cards keep them; this one is of 300 km farther east."""
    grey = np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8)
    for k in range(4):
        shot_from(None, tmp_path, f"{k}.jpg", (3e5 if k == 3 else 0.0, 5.0 * k, 20.0), 0.0, -90.0, grey)
    shots, ((name, why),) = shots_of(tmp_path, None, None, 1.0, has_dem=False)
    assert ([shot.name for shot in shots], name) == (["0.jpg", "1.jpg", "2.jpg"], "3.jpg")
    assert re.match(r"was taken (299|30\d) km away from most; look at it in a run of its own", why)


def test_a_table_without_rows_of_the_pictures_is_refused(tmp_path):
    folder = make_empty(tmp_path / "flight")
    shot_from(None, folder, "a.jpg", (0, 0, 20), 0, -90, np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8))
    (tmp_path / "poses.csv").write_text("file,height_m\nb.jpg,20\n")
    with pytest.raises(UserError, match="no row names a picture of"):
        look_at_flight(folder, tmp_path / "out", Options(poses=tmp_path / "poses.csv"))


def make_empty(folder):
    folder.mkdir()
    return folder


def make_table(folder):
    (folder / "poses.csv").write_text("file,height_m\na.jpg,20\n")
    return folder / "poses.csv"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda folder: folder / "gone", "neither a folder of pictures nor a video"),
        (
            lambda folder: make_empty(folder / "empty"),
            "no picture can be put on the map: there are none in it",
        ),
        (make_table, "is no readable video; give a folder of pictures or a video file"),
    ],
)
def test_nothing_to_look_at_is_one_sentence(make, message, tmp_path):
    with pytest.raises(UserError, match=message):
        look_at_flight(make(tmp_path), tmp_path / "out", Options())
    assert not (tmp_path / "out").exists()
