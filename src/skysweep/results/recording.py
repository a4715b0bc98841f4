"""A mission as an MCAP file of ROS 2 messages, as rosbag2 writes it (profile ros2, CDR).

``ros2 bag``, ``rosbags``, Foxglove and Rerun can read it. Time in the file is seconds since the take-off
command. The topics are those of ``skysweep ros``, and what only a recording has: area and truth, the
vehicle's shape, pictures as JPEG, boxes and map as Foxglove draws them.
"""

from __future__ import annotations

import heapq
import itertools
import json
from collections.abc import Iterable
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.colors import to_hex, to_rgba
from mcap.writer import Writer

from skysweep.geometry.camera import CameraPose, Lens
from skysweep.geometry.frames import rotation_from_euler
from skysweep.mission.notes import LOOKED
from skysweep.mission.orders import ORDER
from skysweep.results.film import FilmedLooks
from skysweep.results.picture_files import told_by_name
from skysweep.results.reporting.style import BLUE, GREY, ORANGE, VERMILLION
from skysweep.results.reporting.wording import order_words, probability_of
from skysweep.results.rings import on_earth
from skysweep.results.run_folder import Record, Run
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.interfaces import definition, make, to_cdr, type_hash
from skysweep.ros.targets import RGBA, KnownTarget, TargetBoard
from skysweep.ros.topics import Topic
from skysweep.types import F64, SETTLING
from skysweep.worlds.world import WorldObject

Timed = tuple[float, Topic, Any]  # a message, or its CDR

_PATH_EVERY = 20  # states, since a path is written whole each time
_QUIET_KINDS = ("state", "sighting", "plan", "clock", "look", "snapshot")


def write_recording(run: Run, path: str | Path) -> Path:
    """Write ``mission.mcap``."""
    path = Path(path)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="skysweep")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for time_s, topic, message in _messages(run):
            if topic.type_name not in schemas:
                text = definition(topic.type_name).encode()
                schemas[topic.type_name] = writer.register_schema(topic.type_name, "ros2msg", text)
            if topic.name not in channels:
                schema, profile = schemas[topic.type_name], topics.rosbag_profile(topic.quality)
                told = {"offered_qos_profiles": profile, "topic_type_hash": type_hash(topic.type_name)}
                channels[topic.name] = writer.register_channel(topic.full_name, "cdr", schema, told)
            nanoseconds = round(time_s * 1e9)
            data = message if isinstance(message, bytes) else to_cdr(message)
            writer.add_message(channels[topic.name], nanoseconds, data, nanoseconds)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _messages(run: Run) -> Iterable[Timed]:
    """All messages in the order of their times. Pictures are read when their turn comes."""
    looks = FilmedLooks(run)
    lens, scale = run.scenario.camera.lens, looks.picture_scale
    lens = Lens(round(lens.width_px * scale), round(lens.height_px * scale), lens.hfov_rad)
    parts = (
        _beginning(run, lens),
        _flight(run),
        _moving(run),
        _film(looks, lens),
        _evidence(run),
        _events(run),
    )
    return heapq.merge(*parts, key=itemgetter(0))


def _beginning(run: Run, lens: Lens) -> Iterable[Timed]:
    yield 0.0, topics.TF_STATIC, m.fixed_transforms()
    yield 0.0, topics.CAMERA_INFO, m.camera_info(0.0, lens)
    yield 0.0, topics.WORLD, m.markers(0.0, _still_life(run))
    yield 0.0, topics.VEHICLE, m.markers(0.0, _vehicle())
    yield 0.0, topics.PLANNED_PATH, m.planned_path(run.plan_enu_m)
    yield 0.0, topics.GEOJSON, make(m.GEOJSON, geojson=_plan_geojson(run))


def _events(run: Run) -> Iterable[Timed]:
    board = TargetBoard()
    for record in sorted(run.records, key=run.since_start):
        time_s = run.since_start(record)
        if record["kind"] not in _QUIET_KINDS:
            yield time_s, topics.ROSOUT, m.log(time_s, _words(record))
        if board.note(record):
            yield time_s, topics.TARGETS, m.markers(time_s, board.marks(), clear=True)
            target = board.targets[record["candidate"]]
            if target.standing in SETTLING:
                yield time_s, topics.GEOJSON, make(m.GEOJSON, geojson=_target_geojson(run, target))


def _film(looks: FilmedLooks, lens: Lens) -> Iterable[Timed]:
    for shot in looks.shots:
        if (jpeg := shot.jpeg()) is not None:
            yield shot.time_s, topics.CAMERA_INFO, m.camera_info(shot.exposed_s, lens)
            image = m.compressed_image(shot.exposed_s, jpeg)
            yield shot.time_s, topics.COMPRESSED_IMAGE, image
        boxes = shot.boxes_xyxy_px * looks.picture_scale
        annotations = m.image_annotations(shot.exposed_s, boxes, shot.labels, to_rgba(ORANGE))
        yield shot.time_s, topics.ANNOTATIONS, annotations


def _evidence(run: Run) -> Iterable[Timed]:
    """The pictures kept of candidates; boxes are drawn in them."""
    told = [(named, path) for path in run.pictures if (named := told_by_name(path)) is not None]
    for (_, named_s), path in sorted(told, key=lambda told: told[0][1]):
        time_s = named_s - float(run.start["t"])
        yield time_s, topics.EVIDENCE, m.compressed_image(time_s, path.read_bytes(), "")


def _flight(run: Run) -> Iterable[Timed]:
    states = run.states
    if not len(states):
        return
    fixes = run.scenario.frame.geodetic_from_enu(states.position_enu_m)
    times, altitudes_m = states.time_s.tolist(), run.altitudes_agl_m
    flown = m.GrowingPath()
    mode = None
    for k, time_s in enumerate(times):
        position = states.position_enu_m[k]
        camera = CameraPose(states.camera_position_enu_m[k], states.R_camera_to_enu[k])
        R = _level_body(camera.R_camera_to_enu)
        yield time_s, topics.TF, m.transforms(time_s, position, R, camera)
        pose = m.pose_stamped(time_s, position, R)
        flown.add(pose)
        yield time_s, topics.POSE, pose
        yield time_s, topics.FIX, m.fix(time_s, fixes[k])
        yield time_s, topics.ALTITUDE, make(topics.ALTITUDE.type_name, data=float(altitudes_m[k]))
        yield time_s, topics.BATTERY, m.battery(time_s, float(states.battery[k]))
        if states.mode[k] != mode:
            mode = states.mode[k]
            yield time_s, topics.STATE, m.text(mode)
        if (k + 1) % _PATH_EVERY == 0 or k + 1 == len(times):
            yield time_s, topics.FLOWN_PATH, flown.cdr(time_s)


def _level_body(R_camera_to_enu: F64) -> F64:
    """The body's attitude: the heading of the picture's top, as the journal keeps no roll and pitch."""
    top = -R_camera_to_enu[:, 1] + R_camera_to_enu[:, 2]
    return rotation_from_euler(0.0, 0.0, float(np.arctan2(top[1], top[0])))


def _still_life(run: Run) -> list[m.Mark]:
    area: shapely.Polygon = run.scenario.area_enu_m
    terrain = run.world.terrain
    marks = []
    for k, ring in enumerate((area.exterior, *area.interiors)):
        xy = np.array(ring.coords)
        points = np.column_stack([xy, terrain.height_m(xy)])
        marks.append(m.Mark("area", k, m.LINE_STRIP, points, (0.3, 0.0, 0.0), to_rgba("0.6")))
    for k, thing in enumerate(run.world.objects if run.has_truth else ()):
        if thing.track is None:
            marks += _truth(k, thing, thing.position_enu_m)
        else:
            _, way = run.world.way(thing, run.last_s)
            marks.append(m.Mark("truth tracks", k, m.LINE_STRIP, way, (0.15, 0.0, 0.0), _truth_rgba(thing)))
    return marks


def _moving(run: Run) -> Iterable[Timed]:
    """What moves, where it is."""
    movers = run.movers
    if not movers:
        return
    times_s, _ = run.world.way(movers[0][1], run.last_s)
    for time_s in times_s.tolist():
        marks = (_truth(k, thing, run.world.position(thing, time_s)) for k, thing in movers)
        yield time_s, topics.MOVING, m.markers(time_s, itertools.chain.from_iterable(marks))


def _truth(k: int, thing: WorldObject, position_enu_m: F64) -> tuple[m.Mark, m.Mark]:
    colour, size = _truth_rgba(thing), max(thing.size_m, 0.3)
    above = position_enu_m + np.array([0.0, 0.0, 1.0])
    return (
        m.Mark("truth", k, m.CYLINDER, position_enu_m, (size, size, 0.1), colour),
        m.Mark("truth labels", k, m.TEXT, above, (0.0, 0.0, 1.0), colour, thing.kind),
    )


def _truth_rgba(thing: WorldObject) -> tuple[float, float, float, float]:
    return to_rgba("white" if thing.is_target else "0.4", 0.8)


def _vehicle() -> list[m.Mark]:
    """A quadrotor, forward arms in another colour."""
    dark, front = to_rgba("0.15"), to_rgba(ORANGE)
    marks = [m.Mark("vehicle", 0, m.CUBE, np.zeros(3), (0.3, 0.2, 0.12), dark, frame=m.BASE)]
    for k, (x, y) in enumerate(((0.25, 0.25), (0.25, -0.25), (-0.25, 0.25), (-0.25, -0.25)), start=1):
        place = np.array([x, y, 0.06])
        colour = front if x > 0 else dark
        marks.append(m.Mark("vehicle", k, m.CYLINDER, place, (0.3, 0.3, 0.02), colour, frame=m.BASE))
    return marks


def _plan_geojson(run: Run) -> str:
    """Search area, no-fly areas, fence, home and the waypoints F on Foxglove's map."""
    scenario = run.scenario
    fence = scenario.geofence_enu_m
    shapes: list[tuple[str, shapely.Geometry, str]] = [
        ("search area", scenario.area_enu_m, BLUE),
        *(("no-fly area", shapely.Polygon(ring), VERMILLION) for ring in scenario.safety.no_fly_enu_m),
        *(() if fence is None else (("fence", shapely.LinearRing(fence), VERMILLION),)),
        ("home", shapely.Point(scenario.home.position_enu_m).buffer(1.0), GREY),
    ]
    if len(run.plan_enu_m) > 1:
        shapes.append(("planned path", shapely.LineString(run.plan_enu_m[:, :2]), GREY))
    return _geojson(run, shapes)


def _target_geojson(run: Run, target: KnownTarget) -> str:
    disc = shapely.Point(target.position_enu_m[:2]).buffer(max(target.radius_95_m, 1.0))
    return _geojson(run, [(target.label, disc, to_hex(RGBA[target.standing]))])


def _geojson(run: Run, shapes: Iterable[tuple[str, shapely.Geometry, str]]) -> str:
    """Features with the name and the style (Leaflet's) that Foxglove's map panel shows."""
    frame, rounded = run.scenario.frame, partial(np.round, decimals=7)
    features = [
        {
            "type": "Feature",
            "geometry": json.loads(shapely.to_geojson(shapely.transform(on_earth(shape, frame), rounded))),
            "properties": {"name": name, "style": {"color": colour, "weight": 2, "fillOpacity": 0.1}},
        }
        for name, shape, colour in shapes
    ]
    return json.dumps({"type": "FeatureCollection", "features": features})


def _words(record: Record) -> str:
    if record["kind"] in (ORDER, LOOKED):
        return order_words(record)
    who = "" if record.get("candidate") is None else f" candidate {record['candidate']}"
    probability = record.get("probability")
    who += "" if probability is None else f", probability {probability_of(probability)}"
    who += "" if record.get("by") is None else f" by the {record['by']}"
    why = f": {record['reason']}" if "reason" in record else ""
    return f"{record['kind'].replace('_', ' ')}{who}{why}"
