"""Exported worlds: everything that a file names is in the folder, and things stand where the mission's do."""

from __future__ import annotations

import itertools
from pathlib import Path
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from skysweep.cli import app
from skysweep.errors import UserError
from skysweep.gazebo.export import FORMATS, MODELS_FOLDER, TREES_MAX, Format, export_world
from skysweep.gazebo.look import GazeboLook, water_tile
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Forest, Light, Scenario
from skysweep.worlds.rendering.gl import film
from skysweep.worlds.scene import make_sun
from skysweep.worlds.textures import ground_textures
from skysweep.worlds.world import build_world

SEED = 3


def small_scenario(surface: str = "grass", **changes: object) -> Scenario:
    return change_scenario(
        load_scenario("clusters"),
        {
            "name": "small",
            "terrain.surface": surface,
            "terrain.hills_height_m": 6.0 if surface != "water" else 0.0,
            "trees": [{"position_enu_m": [20, 30], "kind": k} for k in ("broadleaf", "conifer", "bush")],
            "buildings": [{"position_enu_m": [60, 60]}],
            **changes,
        },
    )


@pytest.fixture(scope="module", params=FORMATS)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    fmt: Format = request.param
    return export_world(small_scenario(), SEED, tmp_path_factory.mktemp(fmt), fmt)


def _models(world_file: Path) -> dict[str, ET.Element]:
    folder = world_file.parent / MODELS_FOLDER
    return {d.name: ET.parse(d / "model.sdf").getroot() for d in sorted(folder.iterdir())}


def _read_obj(path: Path) -> dict[str, list[list[str]]]:
    lines: dict[str, list[list[str]]] = {}
    for line in path.read_text().splitlines():
        word, *rest = line.split()
        lines.setdefault(word, []).append(rest)
    return lines


def test_every_name_in_the_files_is_in_the_folder(exported: Path) -> None:
    models = _models(exported)
    included = [e.text for e in ET.parse(exported).getroot().iterfind(".//include/uri")]
    assert sorted(str(u).removeprefix("model://") for u in included) == sorted(models)
    for name, root in models.items():
        assert root.find("model").attrib["name"] == name  # type: ignore[union-attr]
        for uri in root.iter("uri"):
            path = exported.parent / MODELS_FOLDER / str(uri.text).removeprefix("model://")
            assert path.exists(), path
    for obj in exported.parent.rglob("*.obj"):
        lines = _read_obj(obj)
        mtl = obj.parent / lines["mtllib"][0][0]
        text = mtl.read_text().split()
        made = {b for a, b in itertools.pairwise(text) if a == "newmtl"}
        assert {row[0] for row in lines["usemtl"]} <= made
        for picture in (b for a, b in itertools.pairwise(text) if a == "map_Kd"):
            assert cv2.imread(str(obj.parent / picture)) is not None
        corners = np.array([corner.split("/") for face in lines["f"] for corner in face], dtype=int)
        assert corners.min() == 1
        assert (corners.max(axis=0) == [len(lines["v"]), len(lines["vt"]), len(lines["vn"])]).all()


def test_scripts_name_textures_that_are_there(exported: Path) -> None:
    for script in exported.parent.rglob("*.material"):
        words = script.read_text().split()
        named = [b for a, b in itertools.pairwise(words) if a == "texture"]
        assert len(named) == 3
        for name in named:
            assert (script.parent.parent / "textures" / name).exists()


def test_things_stand_where_the_mission_has_them(exported: Path) -> None:
    world = build_world(small_scenario(), SEED)
    poses = {
        str(e.findtext("name")): np.array(str(e.findtext("pose")).split(), dtype=float)
        for e in ET.parse(exported).getroot().iter("include")
    }
    signs = [o for o in world.objects if o.kind == "stop sign"]
    for number, sign in enumerate(signs, start=1):
        np.testing.assert_allclose(
            poses[f"small_stop_sign_{number}"], [*sign.position_enu_m, 0, 0, 0], atol=1e-6
        )
        obj = exported.parent / MODELS_FOLDER / f"small_stop_sign_{number}" / "meshes" / "mesh.obj"
        v = np.array(_read_obj(obj)["v"], dtype=float)
        assert np.abs(v[:, :2].mean(axis=0)).max() < 0.05
        assert 0.8 < np.ptp(v[:, 0]) < 1.1
    assert "small_building_1" in poses
    assert "small_red_bucket_1" in poses


def test_hills_are_the_terrains(exported: Path) -> None:
    terrain = build_world(small_scenario(), SEED).terrain
    obj = exported.parent / MODELS_FOLDER / "small_ground" / "meshes" / "ground.obj"
    v = np.array(_read_obj(obj)["v"], dtype=float)
    np.testing.assert_allclose(v[:, 2], terrain.height_m(v[:, :2]), atol=1e-3)
    assert np.ptp(v[:, 2]) > 5.0


def test_the_place_on_earth_and_the_wind(exported: Path) -> None:
    scenario = small_scenario()
    root = ET.parse(exported).getroot()
    assert float(root.findtext(".//latitude_deg") or 0) == scenario.home.latitude_deg
    wind = np.array(str(root.findtext(".//wind/linear_velocity")).split(), dtype=float)
    np.testing.assert_allclose(wind, [2 * np.sin(np.radians(60)), 2 * np.cos(np.radians(60)), 0], atol=1e-6)


def test_same_seed_same_files(tmp_path: Path) -> None:
    one, two = (export_world(small_scenario(), 1, tmp_path / n, "gazebo-classic").parent for n in "ab")
    files = sorted(p.relative_to(one) for p in one.rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(two) for p in two.rglob("*") if p.is_file())
    assert all((one / f).read_bytes() == (two / f).read_bytes() for f in files)


def test_light_makes_level_ground_look_as_ours_in_sun_and_shade() -> None:
    sun = make_sun(Light(sun_elevation_deg=35))
    look = GazeboLook.of(sun)
    np.testing.assert_allclose(look.ambient_rgb + look.diffuse_rgb * sun.direction_enu[2], 1.0)
    albedo = np.array([0.15, 0.2, 0.1])
    np.testing.assert_allclose(
        look.shown(albedo) * look.ambient_rgb, film(albedo**2 * sun.sky_rgb), rtol=0.06
    )


def test_tinted_texture_shows_the_colour_of_its_mean_tone() -> None:
    look = GazeboLook.of(make_sun(Light()))
    image = np.full((4, 4, 3), 128, np.uint8)
    shown = look.tint([0.5, 0.4, 0.3], image) * look.texture(image)[0, 0] / 255
    np.testing.assert_allclose(shown, look.shown(np.array([0.5, 0.4, 0.3]) * 128 / 255), atol=0.004)


def test_water_is_dark_and_tiles_without_a_seam() -> None:
    tile = water_tile(ground_textures("water", 0), make_sun(Light())).astype(float)
    assert tile.mean() < 110
    step = np.abs(np.diff(tile, axis=0)).mean()
    assert np.abs(tile[0] - tile[-1]).mean() < 3 * step


def test_water_world_has_a_ground_texture_of_its_own(tmp_path: Path) -> None:
    world_file = export_world(small_scenario("water"), 0, tmp_path / "sea", "gazebo-classic")
    assert (world_file.parent / MODELS_FOLDER / "small_ground" / "meshes" / "ground.png").exists()


def test_bad_input_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").touch()
    with pytest.raises(UserError, match=r"full: is not an empty folder; write another --out"):
        export_world(small_scenario(), 0, tmp_path / "full", "gz")
    with pytest.raises(UserError, match=r"--format blender: .* write one of gazebo-classic, gz"):
        export_world(small_scenario(), 0, tmp_path / "x", "blender")  # type: ignore[arg-type]
    forest = small_scenario().model_copy(update={"forests": [Forest(trees_per_hectare=2000)]})
    with pytest.raises(UserError, match=rf"at most {TREES_MAX}; write a smaller forests\.trees_per_hectare"):
        export_world(forest, 0, tmp_path / "y", "gz")
    assert not (tmp_path / "y").exists()


def test_command_says_how_to_open_it(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["world", "export", "sparse", "--out", str(tmp_path / "w")])
    assert result.exit_code == 0, result.output
    assert "GAZEBO_MODEL_PATH=" in result.output
    assert (tmp_path / "w" / "sparse.world").exists()
