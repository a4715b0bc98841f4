"""Fields that name files of the ground, and the shipped ones."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from tests.worlds.geotiffs import rasterio

from skysweep.errors import UserError
from skysweep.scenarios.files import (
    change_scenario,
    dump_scenario,
    ground_files,
    load_scenario,
    parse_scenario,
    with_paths_beside,
)
from skysweep.worlds.world import build_world, elevation_of

AREA = "name: x\narea: {polygon_enu_m: [[0, 0], [90, 0], [90, 80]]}\n"
ROOT = Path(__file__).parents[2]


def test_paths_start_at_the_scenario_s_folder(tmp_path):
    (tmp_path / "x.yaml").write_text(
        AREA + "terrain: {dem: a/dem.tif, land_cover: lc.tif, orthophoto: /o.tif}\nbuildings_file: b.geojson\n"
    )
    assert ground_files(load_scenario(tmp_path / "x.yaml")) == {
        "terrain.dem": tmp_path / "a/dem.tif",
        "terrain.land_cover": tmp_path / "lc.tif",
        "terrain.orthophoto": Path("/o.tif"),
        "buildings_file": tmp_path / "b.geojson",
    }


def test_a_written_scenario_is_read_again():
    classes = "[{code: 3, surface: rock}, {code: 4, surface: grass, trees_per_hectare: 5}]"
    told = f"terrain: {{dem: /d.tif, dem_unit: feet, land_cover: /l.tif, land_cover_classes: {classes}}}\n"
    scenario = parse_scenario(AREA + told + "roads_file: /r.geojson\n", "x")
    assert parse_scenario(dump_scenario(scenario), "again") == scenario
    changed = change_scenario(scenario, {"terrain.orthophoto": "/o.tif"})
    assert ground_files(changed)["terrain.orthophoto"] == Path("/o.tif")


def test_a_scenario_without_files_is_written_as_before():
    text = dump_scenario(load_scenario("clusters"))
    assert not any(word in text for word in ("dem", "land_cover", "orthophoto", "_file"))


@pytest.mark.parametrize(
    ("terrain", "sentence"),
    [
        ("{dem: d.tif, hills_height_m: 3}", "terrain.dem: is the ground's shape; delete heightmap_m and hills"),
        ("{dem_unit: feet}", "terrain.dem_unit: is that of dem, which is missing"),
        ("{land_cover_classes: [{code: 1, surface: rock}]}", "are those of land_cover, which is missing"),
        (
            "{land_cover: l.tif, land_cover_classes: [{code: 1, surface: rock}, {code: 1, surface: sand}]}",
            "land_cover_classes: 1 is written twice; keep one",
        ),
        ("{land_cover: l.tif, land_cover_classes: [{code: 1, surface: lava}]}", "surface"),
    ],
)
def test_what_contradicts_itself_is_one_sentence(terrain, sentence):
    with pytest.raises(UserError, match=sentence):
        parse_scenario(f"{AREA}terrain: {terrain}\n", "x.yaml")


def test_shipped_files_have_the_same_name_everywhere(tmp_path, monkeypatch):
    valley = load_scenario("valley")
    assert valley.terrain.dem == "shipped:valley/dem.tif"
    assert with_paths_beside(valley, tmp_path) == valley
    assert all(path.is_file() for path in ground_files(valley).values())
    assert sum(path.stat().st_size for path in ground_files(valley).values()) < 400_000


def test_valley_is_what_its_tool_makes(tmp_path):
    spec = importlib.util.spec_from_file_location("make_valley", ROOT / "tools" / "make_valley.py")
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    tool.make(tmp_path)
    shipped = {path.name: path for path in ground_files(load_scenario("valley")).values()}
    assert {path.name for path in tmp_path.iterdir()} == set(shipped)
    for name, path in shipped.items():
        if name.endswith(".tif"):
            with rasterio.open(path) as one, rasterio.open(tmp_path / name) as other:
                np.testing.assert_allclose(one.read(), other.read(), atol=0.11)  # a tenth is rounded
                assert one.transform.almost_equals(other.transform)
                assert one.crs == other.crs
        else:
            assert json.loads(path.read_text()) == json.loads((tmp_path / name).read_text())


def test_valley_is_woodland_and_meadow_between_hillsides():
    valley = load_scenario("valley")
    world = build_world(valley, 0)
    assert 150 < valley.area_enu_m.area / 1e4 < 250
    assert np.ptp(world.terrain.heights_m) > 80
    share = np.bincount(world.terrain.cover.codes.ravel(), minlength=7) / world.terrain.cover.codes.size
    named = dict(zip(world.terrain.cover.names, share, strict=True))
    assert 0.3 < named["forest floor"] < 0.7
    assert 0.3 < named["grass"] < 0.7
    assert len(world.trees) > 5000
    assert len(world.buildings) >= 4, "the barn goes round a corner"
    assert elevation_of(valley).home_amsl_m == pytest.approx(valley.home.altitude_amsl_m, abs=0.5)
    assert elevation_of(valley).notes == ()
