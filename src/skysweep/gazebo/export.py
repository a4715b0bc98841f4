"""A scenario's world as a self-contained folder for Gazebo, with our renderer's meshes and light."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np

from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.gazebo.look import TILE_M, WATER_TILE_M, GazeboLook, ground_tile, water_tile
from skysweep.gazebo.mesh_files import material, write_mesh, write_obj, write_picture
from skysweep.gazebo.sdf import include, mesh, pose, static_model, tag, write_model, write_sdf
from skysweep.scenarios.model import Home, Scenario, Wind
from skysweep.types import F64
from skysweep.worlds.meshes import Mesh, merge, yaw_rotation
from skysweep.worlds.scene import PLANT_TEXTURE_M, Planting, Scene, build_scene
from skysweep.worlds.textures import DETAIL_M, MACRO_M, MIDDLE_M
from skysweep.worlds.world import World, build_world

Format = Literal["gazebo-classic", "gz"]

log = logging.getLogger(__name__)

FORMATS: tuple[Format, ...] = ("gazebo-classic", "gz")
MODELS_FOLDER = "models"
PLANT_TILE_M = 48.0  # plants in a square of this side are one mesh
PLANT_FACES_MAX = 200_000  # of all plants; above it they get coarser
TREES_MAX = 5000
STEP_S = 0.004
GZ_SYSTEMS = (
    ("gz-sim-physics-system", "gz::sim::systems::Physics"),
    ("gz-sim-user-commands-system", "gz::sim::systems::UserCommands"),
    ("gz-sim-scene-broadcaster-system", "gz::sim::systems::SceneBroadcaster"),
    ("gz-sim-contact-system", "gz::sim::systems::Contact"),
    ("gz-sim-imu-system", "gz::sim::systems::Imu"),
    ("gz-sim-air-pressure-system", "gz::sim::systems::AirPressure"),
    ("gz-sim-magnetometer-system", "gz::sim::systems::Magnetometer"),
    ("gz-sim-navsat-system", "gz::sim::systems::NavSat"),
)


def export_world(scenario: Scenario, seed: int, folder: Path, fmt: Format) -> Path:
    """Writes the world of ``scenario`` and ``seed`` into a new folder; returns the path of the world file.

    The world's frame is ENU with the scenario's origin; Gazebo gets its latitude and longitude. Raises
    UserError if the folder is not empty, or the world has more trees than Gazebo can load. What moves is
    written where it is at time 0, with a warning.
    """
    if fmt not in FORMATS:
        raise UserError(f"--format {fmt}: there is no such format; write one of {', '.join(FORMATS)}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"{folder}: is not an empty folder; write another --out")
    world = build_world(scenario, seed)
    n_moving = sum(o.track is not None for o in world.objects)
    if n_moving:
        log.warning("%d objects move; motion is not exported, they stand where they are at time 0", n_moving)
        world = replace(world, objects=tuple(replace(o, track=None) for o in world.objects))
    with whole_files(folder) as unfinished:
        path = write_world(world, scenario, unfinished, fmt)
    return folder / path.name


def write_world(
    world: World,
    scenario: Scenario,
    folder: Path,
    fmt: Format,
    extras: Iterable[ET.Element] = (),
    step_s: float = STEP_S,
    in_real_time: bool = True,
) -> Path:
    """Writes models and world file; ``extras`` (models, plugins) are put into the world as they are.

    Gazebo takes steps of ``step_s``, in real time or as fast as it can. Raises UserError if anything moves.
    """
    if any(o.track is not None for o in world.objects):
        raise UserError(
            f"{scenario.name}: has objects with a motion, and nothing moves in Gazebo; delete every motion, "
            "or render with gl or embree"
        )
    name = scenario.name
    if len(world.trees) > TREES_MAX:
        raise UserError(
            f"{name}: has {len(world.trees)} trees, and Gazebo takes at most {TREES_MAX}; "
            "write a smaller forests.trees_per_hectare"
        )
    scene = build_scene(world)
    look = GazeboLook.of(scene.sun)
    models = folder / MODELS_FOLDER
    includes = [_write_ground(models / f"{name}_ground", scene, look, fmt)]
    includes += _write_things(models, name, world, scene, look)
    if world.trees:
        includes.append(_write_plants(models / f"{name}_plants", world, scene, look))
    content = tag(
        "world",
        None,
        *(_systems() if fmt == "gz" else ()),
        _physics(step_s, in_real_time),
        _coordinates(scenario.home),
        _wind(scenario.wind),
        _scene(look, fmt),
        _sun(scene, look, fmt),
        *includes,
        *extras,
        name=name if fmt == "gz" else "default",
    )
    path = folder / f"{name}.{'sdf' if fmt == 'gz' else 'world'}"
    write_sdf(path, content)
    return path


def _write_ground(folder: Path, scene: Scene, look: GazeboLook, fmt: Format) -> ET.Element:
    """Classic blends the three scales of the ground; gz and water get one texture that holds all of them."""
    meshes, textures = folder / "meshes", folder / "materials" / "textures"
    meshes.mkdir(parents=True)
    script: list[ET.Element] = []
    ground = scene.ground_textures
    if scene.terrain.surface == "water":
        tile_m, picture = WATER_TILE_M, water_tile(ground, scene.sun)
    elif fmt == "gz":
        tile_m, picture = TILE_M, ground_tile(ground, look)
    else:
        tile_m, picture = DETAIL_M, look.texture(ground.detail)
        textures.mkdir(parents=True)
        for scale, image in (("middle", ground.middle), ("macro", ground.macro)):
            write_picture(textures / f"{folder.name}_{scale}.png", image)
        write_picture(textures / f"{folder.name}_detail.png", picture)
        (folder / "materials" / "scripts").mkdir()
        (folder / "materials" / "scripts" / "ground.material").write_text(_ground_script(folder.name))
        uri = f"model://{folder.name}/materials"
        names = [tag("uri", f"{uri}/scripts"), tag("uri", f"{uri}/textures"), tag("name", folder.name)]
        script = [tag("material", None, tag("script", None, *names))]
    surface = scene.ground.mesh()
    uv = surface.vertices[:, :2] / tile_m
    write_obj(meshes / "ground.obj", surface, uv, np.zeros(len(surface.faces), dtype=int))
    if not script:
        write_picture(meshes / "ground.png", picture)
    (meshes / "ground.mtl").write_text(material("m0", np.ones(3), None if script else "ground.png"))
    shape = mesh(f"model://{folder.name}/meshes/ground.obj")
    solid = shape
    if scene.terrain.is_flat:
        solid = tag("geometry", None, tag("plane", None, tag("normal", [0, 0, 1]), tag("size", [8000, 8000])))
    level = float(scene.terrain.heights_m[0, 0]) if scene.terrain.is_flat else 0.0
    parts = [
        tag("collision", None, pose((0, 0, level)), solid, name="collision"),
        tag("visual", None, tag("cast_shadows", False), shape, *script, name="visual"),
    ]
    write_model(folder, static_model(folder.name, parts), f"Ground: {scene.terrain.surface}")
    return include(folder.name)


def _ground_script(name: str) -> str:
    """Texture coordinates are in units of the detail; the other two scales are stretched, 0.5 is neutral."""
    wide = "".join(
        f"""
      texture_unit
      {{
        texture {name}_{scale}.png
        scale {size_m / DETAIL_M:.4g} {size_m / DETAIL_M:.4g}
        filtering trilinear
        colour_op_ex modulate_x2 src_texture src_current
      }}"""
        for scale, size_m in (("middle", MIDDLE_M), ("macro", MACRO_M))
    )
    return f"""material {name}
{{
  technique
  {{
    pass
    {{
      ambient 1 1 1 1
      diffuse 1 1 1 1
      specular 0 0 0 1 0
      texture_unit
      {{
        texture {name}_detail.png
        filtering trilinear
      }}{wide}
    }}
  }}
}}
"""


def _write_things(
    models: Path, name: str, world: World, scene: Scene, look: GazeboLook
) -> Iterator[ET.Element]:
    """One model per object and building, about its own origin."""
    counts: dict[str, int] = {}
    places = [(o.kind, o.position_enu_m) for o in world.objects]
    places += [("building", b.position_enu_m) for b in world.buildings]
    for (kind, position), solid in zip(places, scene.solids, strict=True):
        counts[kind] = counts.get(kind, 0) + 1
        folder = models / f"{name}_{kind.replace(' ', '_')}_{counts[kind]}"
        write_mesh(folder / "meshes", "mesh", solid.mesh.moved(-position), scene.layers, look)
        shape = mesh(f"model://{folder.name}/meshes/mesh.obj")
        parts = [tag("visual", None, shape, name="visual")]
        if kind == "building":
            parts.append(tag("collision", None, shape, name="collision"))
        write_model(folder, static_model(folder.name, parts), kind.capitalize())
        yield include(folder.name, position)


def _write_plants(folder: Path, world: World, scene: Scene, look: GazeboLook) -> ET.Element:
    """All plants as one model: a mesh per square of ground, a collision cylinder per trunk."""
    detail = _affordable_detail(scene.plantings)
    tiles: dict[tuple[int, int], list[Mesh]] = {}
    for planting in scene.plantings:
        unit = planting.meshes[detail]
        for place in planting.places.astype(float):
            key = (int(place[0] // PLANT_TILE_M), int(place[1] // PLANT_TILE_M))
            tiles.setdefault(key, []).append(_planted(unit, place))
    parts = []
    for index, key in enumerate(sorted(tiles)):
        write_mesh(folder / "meshes", f"tile{index}", merge(tiles[key]), scene.layers, look)
        shape = mesh(f"model://{folder.name}/meshes/tile{index}.obj")
        parts.append(tag("visual", None, shape, name=f"tile{index}"))
    for index, tree in enumerate(t for t in world.trees if t.kind != "bush"):
        x, y, z = tree.position_enu_m
        size = tag("radius", 0.07 * tree.crown_radius_m), tag("length", tree.height_m)
        cylinder = tag("geometry", None, tag("cylinder", None, *size))
        at = pose((x, y, z + tree.height_m / 2))
        parts.append(tag("collision", None, at, cylinder, name=f"trunk{index}"))
    write_model(folder, static_model(folder.name, parts), "Trees and bushes")
    return include(folder.name)


def _affordable_detail(plantings: tuple[Planting, ...]) -> int:
    """The finest detail with at most PLANT_FACES_MAX faces in all plants, or the coarsest."""
    finest = len(plantings[0].meshes) - 1
    for detail in range(finest, 0, -1):
        if sum(len(p.meshes[detail].faces) * len(p.places) for p in plantings) <= PLANT_FACES_MAX:
            return detail
    return 0


def _planted(unit: Mesh, place: F64) -> Mesh:
    """A unit mesh at x, y, z, yaw, radius, height, shade, its texture in metres."""
    x, y, z, yaw, radius, height, shade = place.tolist()
    sized = unit.vertices * [radius, radius, height]
    plant = unit.moved((x, y, z), yaw_rotation(yaw), (radius, radius, height)).tinted(shade)
    uv = (sized[:, :2] + sized[:, 2:] * [0.61, 0.73]) / PLANT_TEXTURE_M
    texture = np.column_stack([uv, unit.texture[:, 2]]).astype(np.float32)
    return replace(plant, texture=texture)


def _systems() -> Iterator[ET.Element]:
    for filename, name in GZ_SYSTEMS:
        yield tag("plugin", None, filename=filename, name=name)
    engine = tag("render_engine", "ogre2")
    yield tag("plugin", None, engine, filename="gz-sim-sensors-system", name="gz::sim::systems::Sensors")


def _physics(step_s: float, in_real_time: bool) -> ET.Element:
    return tag(
        "physics",
        None,
        tag("max_step_size", step_s),
        tag("real_time_factor", float(in_real_time)),  # for gz; 0 is as fast as it can
        tag("real_time_update_rate", 1.0 / step_s if in_real_time else 0.0),
        name="physics",
        type="ode",
        default="true",
    )


def _coordinates(home: Home) -> ET.Element:
    return tag(
        "spherical_coordinates",
        None,
        tag("surface_model", "EARTH_WGS84"),
        tag("world_frame_orientation", "ENU"),
        tag("latitude_deg", home.latitude_deg),
        tag("longitude_deg", home.longitude_deg),
        tag("elevation", home.altitude_amsl_m),
        tag("heading_deg", 0.0),
    )


def _wind(wind: Wind) -> ET.Element:
    towards = np.radians(wind.from_heading_deg + 180.0)
    velocity = wind.mean_speed_mps * np.array([np.sin(towards), np.cos(towards), 0.0])
    return tag("wind", None, tag("linear_velocity", np.round(velocity, 6)))


def _scene(look: GazeboLook, fmt: Format) -> ET.Element:
    return tag(
        "scene",
        None,
        tag("ambient", [*look.ambient_rgb, 1.0]),
        tag("background", [*look.sky_rgb, 1.0]),
        tag("shadows", fmt == "gz"),
    )


def _sun(scene: Scene, look: GazeboLook, fmt: Format) -> ET.Element:
    return tag(
        "light",
        None,
        tag("cast_shadows", fmt == "gz"),
        pose((0, 0, 500)),
        tag("diffuse", [*look.diffuse_rgb, 1.0]),
        tag("specular", [0, 0, 0, 1]),
        tag("direction", -scene.sun.direction_enu),
        name="sun",
        type="directional",
    )
