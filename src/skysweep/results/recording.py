"""A mission as an MCAP file of ROS 2 messages, as rosbag2 writes it (profile ros2, CDR).

``ros2 bag``, ``rosbags``, Foxglove and Rerun can read it. Time in the file is seconds since the take-off
command. The topics are those of ``skysweep ros``, and ``/skysweep/world`` with area, home and the truth.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.colors import to_rgba
from mcap.writer import Writer

from skysweep.geometry.camera import CameraPose
from skysweep.geometry.frames import rotation_from_euler
from skysweep.mission.notes import LOOKED
from skysweep.mission.orders import ORDER
from skysweep.results.reporting.wording import order_words, probability_of
from skysweep.results.run_folder import Record, Run
from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.interfaces import definition, to_cdr, type_hash
from skysweep.ros.targets import TargetBoard
from skysweep.ros.topics import Topic
from skysweep.types import F64

Timed = tuple[float, Topic, Any]

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
        for time_s, topic, message in sorted(_messages(run), key=lambda timed: timed[0]):
            if topic.type_name not in schemas:
                text = definition(topic.type_name).encode()
                schemas[topic.type_name] = writer.register_schema(topic.type_name, "ros2msg", text)
            if topic.name not in channels:
                schema, profile = schemas[topic.type_name], topics.rosbag_profile(topic.quality)
                told = {"offered_qos_profiles": profile, "topic_type_hash": type_hash(topic.type_name)}
                channels[topic.name] = writer.register_channel(topic.full_name, "cdr", schema, told)
            nanoseconds = round(time_s * 1e9)
            writer.add_message(channels[topic.name], nanoseconds, to_cdr(message), nanoseconds)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def _messages(run: Run) -> Iterable[Timed]:
    yield 0.0, topics.TF_STATIC, m.fixed_transforms()
    yield 0.0, topics.CAMERA_INFO, m.camera_info(0.0, run.scenario.camera.lens)
    yield 0.0, topics.WORLD, m.markers(0.0, _still_life(run))
    yield 0.0, topics.PLANNED_PATH, m.planned_path(run.plan_enu_m)
    yield from _flight(run)
    board = TargetBoard()
    for record in run.records:
        time_s = run.since_start(record)
        if record["kind"] not in _QUIET_KINDS:
            yield time_s, topics.ROSOUT, m.log(time_s, _words(record))
        if board.note(record):
            yield time_s, topics.TARGETS, m.markers(time_s, board.marks(), clear=True)


def _flight(run: Run) -> Iterable[Timed]:
    states = run.states
    if not len(states):
        return
    fixes = run.scenario.frame.geodetic_from_enu(states.position_enu_m)
    times = states.time_s.tolist()
    flown: list[Any] = []
    mode = None
    for k, time_s in enumerate(times):
        position = states.position_enu_m[k]
        camera = CameraPose(states.camera_position_enu_m[k], states.R_camera_to_enu[k])
        R = _level_body(camera.R_camera_to_enu)
        yield time_s, topics.TF, m.transforms(time_s, position, R, camera)
        flown.append(m.pose_stamped(time_s, position, R))
        yield time_s, topics.POSE, flown[-1]
        yield time_s, topics.FIX, m.fix(time_s, fixes[k])
        yield time_s, topics.BATTERY, m.battery(time_s, float(states.battery[k]))
        if states.mode[k] != mode:
            mode = states.mode[k]
            yield time_s, topics.STATE, m.text(mode)
        if (k + 1) % _PATH_EVERY == 0 or k + 1 == len(times):
            yield time_s, topics.FLOWN_PATH, m.path(time_s, flown)


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
        colour = to_rgba("white" if thing.is_target else "0.4", 0.8)
        size = max(thing.size_m, 0.3)
        position = thing.position_enu_m
        marks.append(m.Mark("truth", k, m.CYLINDER, position, (size, size, 0.1), colour))
        above = position + np.array([0.0, 0.0, 1.0])
        marks.append(m.Mark("truth labels", k, m.TEXT, above, (0.0, 0.0, 1.0), colour, thing.kind))
    return marks


def _words(record: Record) -> str:
    if record["kind"] in (ORDER, LOOKED):
        return order_words(record)
    who = "" if record.get("candidate") is None else f" candidate {record['candidate']}"
    probability = record.get("probability")
    who += "" if probability is None else f", probability {probability_of(probability)}"
    who += "" if record.get("by") is None else f" by the {record['by']}"
    why = f": {record['reason']}" if "reason" in record else ""
    return f"{record['kind'].replace('_', ' ')}{who}{why}"
