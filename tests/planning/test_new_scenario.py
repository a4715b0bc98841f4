"""Scenarios over one's own ground: drafted, written, planned and flown."""

import json

import numpy as np
import pytest
import shapely
from tests.worlds.geotiffs import LATITUDE_DEG, LONGITUDE_DEG, over, placed, slope, write
from tests.worlds.test_land_cover import collection
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.flights.advise import advise
from skysweep.flights.fly import fly_in_memory
from skysweep.planning.area_files import scenario_from_area
from skysweep.planning.flight_plan import plan_scenario
from skysweep.planning.qgc import plan_for_qgc, write_plan
from skysweep.scenarios.files import load_scenario
from skysweep.worlds.obstacles import known_obstacles
from skysweep.worlds.world import build_terrain, elevation_of

SIZE = (120, 140)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with an area and the files of its ground: woods in the west, meadow in the east."""
    monkeypatch.chdir(tmp_path)
    field = shapely.box(200, 100, 400, 250)
    collection(tmp_path / "area.geojson", (field, {}))
    write(tmp_path / "dem.tif", slope(SIZE), transform=placed(10.0, SIZE))
    codes = np.full(SIZE, 10, np.uint8)
    codes[:, 60:] = 30
    write(tmp_path / "lc.tif", codes, transform=placed(10.0, SIZE))
    collection(tmp_path / "b.geojson", (shapely.box(300, 180, 320, 190), {"building": "barn"}))
    return tmp_path


def new(*words):
    return CliRunner().invoke(app, ["scenarios", "new", "--area", "area.geojson", "--dem", "dem.tif", *words])


def test_the_scenario_can_be_planned_and_flown(place):
    done = new("--landcover", "lc.tif", "--buildings", "b.geojson", "--out", "mine.yaml", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["dem_pixel_m"] == pytest.approx(10.0, abs=0.05)
    assert "TM35FIN" in told["dem_crs"]
    assert (told["filled"], told["buildings"], told["orthophoto_crs"]) == (0.0, 1, None)
    assert not told["dem_states_unit"]
    assert set(told["surfaces"]) == {"forest floor", "grass"}
    scenario = load_scenario(place / "mine.yaml")
    assert scenario.name == "mine"
    assert scenario.terrain.dem == str(place / "dem.tif")
    assert scenario.home.altitude_amsl_m == pytest.approx(elevation_of(scenario).home_amsl_m, abs=0.06)
    _, estimate = plan_scenario(scenario)
    assert estimate.batteries <= scenario.vehicle.batteries
    summary = fly_in_memory(scenario, 0)
    assert summary["end_reason"] == "completed", summary
    assert summary["area_covered"] > 0.95


def test_home_is_open_ground_beside_the_area(place):
    assert new("--landcover", "lc.tif", "--out", "mine.yaml").exit_code == 0
    scenario = load_scenario(place / "mine.yaml")
    area = scenario.area_enu_m
    home = shapely.Point(0, 0)
    assert 5.0 < area.distance(home) < 20.0
    assert build_terrain(scenario).surface_at(0.0, 0.0) == "grass"
    assert known_obstacles(scenario).top_within_m(np.zeros((1, 2)), 10.0)[0] == -np.inf


def test_home_may_be_given(place):
    assert new("--out", "mine.yaml", "--home", f"{LATITUDE_DEG},{LONGITUDE_DEG}").exit_code == 0
    home = load_scenario(place / "mine.yaml").home
    assert (home.latitude_deg, home.longitude_deg) == (LATITUDE_DEG, LONGITUDE_DEG)
    assert new("--out", "other.yaml", "--home", "somewhere").exit_code == 2


def test_a_file_is_only_replaced_when_told(place):
    (place / "mine.yaml").write_text("mine")
    refused = new("--out", "mine.yaml")
    assert refused.exit_code == 2
    assert "--out mine.yaml: exists; write another, or --overwrite" in refused.output
    assert (place / "mine.yaml").read_text() == "mine"
    assert new("--out", "mine.yaml", "--overwrite").exit_code == 0
    assert load_scenario(place / "mine.yaml").name == "mine"


def test_nothing_that_was_given_is_replaced(place):
    before = (place / "area.geojson").read_bytes()
    refused = new("--out", "area.geojson", "--overwrite")
    assert refused.exit_code == 2
    assert "area.geojson: was given, and would be replaced; write another place with --out" in refused.output
    assert (place / "area.geojson").read_bytes() == before


@pytest.mark.parametrize("target", ["person", "boat", "stop sign"])
def test_heights_suit_the_target(place, target):
    assert new("--out", "mine.yaml", "--target", target).exit_code == 0
    scenario = load_scenario(place / "mine.yaml")
    assert scenario.target_classes == (target,)
    assert scenario.pixels_on_target(scenario.search.scan_altitude_agl_m) >= 20
    assert scenario.search.check_altitude_agl_m < scenario.search.scan_altitude_agl_m


@pytest.mark.parametrize("target", ["person", "boat", "stop sign"])
def test_what_is_written_needs_no_warning(place, target):
    done = new("--out", "mine.yaml", "--target", target)
    assert "warning" not in done.output
    scenario = load_scenario(place / "mine.yaml")
    assert scenario.detector == load_scenario("valley").detector
    assert all(option.pod > 0.8 for option in advise(scenario, 0.8).options)


def test_a_boat_is_searched_from_land_where_there_is_land(place):
    codes = np.full(SIZE, 30, np.uint8)
    codes[:, 70:] = 80
    write(place / "lc.tif", codes, transform=placed(10.0, SIZE))
    assert new("--landcover", "lc.tif", "--target", "boat", "--out", "mine.yaml").exit_code == 0
    assert build_terrain(load_scenario(place / "mine.yaml")).surface_at(0.0, 0.0) == "grass"


def test_a_building_above_the_ceiling_is_named_with_its_place(place):
    tower = shapely.box(300, 180, 310, 190)
    collection(place / "b.geojson", (tower, {"building": "tower", "height": "150"}))
    refused = new("--buildings", "b.geojson", "--out", "mine.yaml")
    assert refused.exit_code == 2
    assert "b.geojson: holds a building of 150 m at 61.00166, " in refused.output


def test_home_and_fence_of_a_plan_are_kept(place):
    area = scenario_from_area(place / "area.geojson")
    fenced = area.model_copy(update={"geofence_enu_m": [(-300, -90), (200, -90), (200, 390), (-300, 390)]})
    kept_out = [[(150, 300), (170, 300), (170, 320)]]
    fenced = fenced.model_copy(update={"safety": fenced.safety.model_copy(update={"no_fly_enu_m": kept_out})})
    write_plan(place / "drawn.plan", plan_for_qgc(fenced, plan_scenario(fenced)[0]))
    words = ["--area", "drawn.plan", "--dem", "dem.tif", "--out", "mine.yaml"]
    done = CliRunner().invoke(app, ["scenarios", "new", *words])
    assert done.exit_code == 0, done.output
    scenario = load_scenario(place / "mine.yaml")
    assert scenario.home.latitude_deg == pytest.approx(area.home.latitude_deg, abs=1e-6)
    assert np.array(scenario.geofence_enu_m) == pytest.approx(np.array(fenced.geofence_enu_m), abs=0.1)
    assert np.array(scenario.safety.no_fly_enu_m[0]) == pytest.approx(np.array(kept_out[0]), abs=0.1)


def test_another_target_is_refused(place):
    refused = new("--out", "mine.yaml", "--target", "cat")
    assert refused.exit_code == 2
    assert "--target cat: is nothing to search for; write stop sign, person, boat" in refused.output


def test_ground_that_does_not_reach_is_refused_with_nothing_written(place):
    write(place / "dem.tif", slope((20, 20)), transform=placed(10.0, (20, 20)))
    refused = new("--out", "mine.yaml")
    assert refused.exit_code == 2
    assert "short of the area" in refused.output
    assert not (place / "mine.yaml").exists()


def test_no_place_to_take_off_from(place):
    row, _ = np.mgrid[: SIZE[0], : SIZE[1]]
    steep = (100.0 + 8.0 * row).astype(np.float32)
    write(place / "dem.tif", steep, transform=placed(10.0, SIZE))
    refused = new("--out", "mine.yaml")
    assert (
        "has no open and level ground beside it to take off from; choose a place with --home"
        in refused.output
    )
    assert over().name == "here"
