"""A mission as an MCAP file with Foxglove's schemas: opens in Foxglove and Rerun.

Time in the file is seconds since the take-off command. Topics: ``/tf`` (frames ``enu``, ``vehicle``,
``camera``), ``/vehicle/pose``, ``/vehicle/fix``, ``/camera/calibration``, ``/scene`` (area, transects, truth,
track, candidates) and ``/log``.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import shapely
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from matplotlib.colors import to_rgba
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from skysweep.results.figures import ALTITUDE_COLOURS, GREEN, ORANGE, VERMILLION
from skysweep.results.run_folder import Record, Run

F64 = NDArray[np.float64]

_FRAME = "enu"
_CANDIDATE_COLOURS = {"scanned": ORANGE, "confirmed": GREEN, "rejected": VERMILLION}
_QUIET_KINDS = ("state", "sighting", "plan")


def write_recording(run: Run, path: str | Path) -> Path:
    """Write ``mission.mcap``."""
    path = Path(path)
    with path.open("wb") as file, Writer(file) as writer:
        for time_s, topic, message in sorted(_messages(run), key=lambda m: m[0]):
            nanoseconds = round(time_s * 1e9)
            writer.write_message(topic, message, log_time=nanoseconds, publish_time=nanoseconds)
    return path


def _messages(run: Run) -> Iterable[tuple[float, str, Message]]:
    lens = run.scenario.camera.lens
    yield (
        0.0,
        "/camera/calibration",
        CameraCalibration(
            timestamp=Timestamp(),
            frame_id="camera",
            width=lens.width_px,
            height=lens.height_px,
            distortion_model="plumb_bob",
            D=[0.0] * 5,
            K=lens.K.ravel(),
            R=np.eye(3).ravel(),
            P=np.column_stack([lens.K, np.zeros(3)]).ravel(),
        ),
    )
    yield 0.0, "/scene", SceneUpdate(entities=_still_life(run))
    yield from _flight(run)
    for record in run.records:
        time_s = run.since_start(record)
        if record["kind"] not in _QUIET_KINDS:
            yield time_s, "/log", _log(record, time_s)
        if record["kind"] in _CANDIDATE_COLOURS and record.get("p") is not None:
            yield time_s, "/scene", SceneUpdate(entities=[_candidate(record, time_s)])


def _flight(run: Run) -> Iterable[tuple[float, str, Message]]:
    states = run.states
    fixes = run.scenario.frame.geodetic_from_enu(states.position_enu_m) if len(states) else np.zeros((0, 3))
    turns = Rotation.from_matrix(states.R_camera_to_enu).as_quat() if len(states) else np.zeros((0, 4))
    top_m = max(float(states.position_enu_m[:, 2].max(initial=1.0)), 1.0)
    for k in range(len(states)):
        time_s, position = float(states.time_s[k]), states.position_enu_m[k]
        stamp = _stamp(time_s)
        yield time_s, "/tf", _transform(stamp, "vehicle", position, np.array([0.0, 0.0, 0.0, 1.0]))
        yield time_s, "/tf", _transform(stamp, "camera", states.camera_position_enu_m[k], turns[k])
        yield time_s, "/vehicle/pose", PoseInFrame(timestamp=stamp, frame_id=_FRAME, pose=_pose(position))
        latitude, longitude, altitude = (float(v) for v in fixes[k])
        fix = LocationFix(
            timestamp=stamp, frame_id="vehicle", latitude=latitude, longitude=longitude, altitude=altitude
        )
        yield time_s, "/vehicle/fix", fix
        if k:
            colour = _colour(ALTITUDE_COLOURS(position[2] / top_m))
            piece = _line(states.position_enu_m[k - 1 : k + 1], LinePrimitive.LINE_STRIP, colour, 2.5)
            yield time_s, "/scene", SceneUpdate(entities=[_entity(f"track {k}", time_s, lines=[piece])])


def _still_life(run: Run) -> list[SceneEntity]:
    """What does not change: area, transects, home and the truth."""
    area: shapely.Polygon = run.scenario.area_enu_m
    terrain = run.world.terrain
    outlines = []
    for ring in (area.exterior, *area.interiors):
        xy = np.array(ring.coords)[:-1]
        points = np.column_stack([xy, terrain.height_m(xy)])
        outlines.append(_line(points, LinePrimitive.LINE_LOOP, _colour("0.6"), 2.0))
    transects = _line(run.plan_enu_m, LinePrimitive.LINE_STRIP, _colour("0.5", 0.6), 1.0)
    entities = [_entity("area", 0.0, lines=outlines), _entity("transects", 0.0, lines=[transects])]
    for k, thing in enumerate(run.world.objects):
        colour = _colour("white" if thing.is_target else "0.4", 0.8)
        entities.append(
            _entity(
                f"truth {k}",
                0.0,
                cylinders=[_disc(thing.position_enu_m, max(thing.size_m, 0.3), colour)],
                texts=[_text(thing.position_enu_m, thing.kind, colour)],
            )
        )
    return entities


def _candidate(record: Record, time_s: float) -> SceneEntity:
    colour = _colour(_CANDIDATE_COLOURS[record["kind"]], 0.7)
    position = np.array(record["p"], dtype=float)
    label = f"{record['candidate']} {record['kind']}"
    return _entity(
        f"candidate {record['candidate']}",
        time_s,
        cylinders=[_disc(position, 2.0, colour)],
        texts=[_text(position, label, colour)],
    )


def _log(record: Record, time_s: float) -> Log:
    who = "" if record.get("candidate") is None else f" candidate {record['candidate']}"
    why = f": {record['reason']}" if "reason" in record else ""
    message = f"{record['kind'].replace('_', ' ')}{who}{why}"
    return Log(timestamp=_stamp(time_s), level=Log.INFO, message=message, name="mission")


def _entity(
    identity: str,
    time_s: float,
    lines: Iterable[LinePrimitive] = (),
    cylinders: Iterable[CylinderPrimitive] = (),
    texts: Iterable[TextPrimitive] = (),
) -> SceneEntity:
    return SceneEntity(
        timestamp=_stamp(time_s), frame_id=_FRAME, id=identity, lines=lines, cylinders=cylinders, texts=texts
    )


def _transform(stamp: Timestamp, child: str, position: F64, quaternion_xyzw: F64) -> FrameTransform:
    return FrameTransform(
        timestamp=stamp,
        parent_frame_id=_FRAME,
        child_frame_id=child,
        translation=_vector(position),
        rotation=_quaternion(quaternion_xyzw),
    )


def _line(points: F64, kind: LinePrimitive.Type.ValueType, colour: Color, width_px: float) -> LinePrimitive:
    corners = [Point3(x=float(p[0]), y=float(p[1]), z=float(p[2])) for p in points]
    return LinePrimitive(
        type=kind,
        pose=_pose(np.zeros(3)),
        thickness=width_px,
        scale_invariant=True,
        points=corners,
        color=colour,
    )


def _disc(position: F64, diameter_m: float, colour: Color) -> CylinderPrimitive:
    size = Vector3(x=diameter_m, y=diameter_m, z=0.1)
    return CylinderPrimitive(pose=_pose(position), size=size, bottom_scale=1.0, top_scale=1.0, color=colour)


def _text(position: F64, text: str, colour: Color) -> TextPrimitive:
    return TextPrimitive(
        pose=_pose(position + np.array([0.0, 0.0, 1.0])),
        billboard=True,
        font_size=12.0,
        scale_invariant=True,
        color=colour,
        text=text,
    )


def _pose(position: F64) -> Pose:
    return Pose(position=_vector(position), orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))


def _vector(v: F64) -> Vector3:
    return Vector3(x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _quaternion(q: F64) -> Quaternion:
    return Quaternion(x=float(q[0]), y=float(q[1]), z=float(q[2]), w=float(q[3]))


def _colour(colour: object, alpha: float = 1.0) -> Color:
    r, g, b, _ = to_rgba(colour)  # type: ignore[arg-type]
    return Color(r=r, g=g, b=b, a=alpha)


def _stamp(time_s: float) -> Timestamp:
    nanoseconds = round(time_s * 1e9)
    return Timestamp(seconds=nanoseconds // 10**9, nanos=nanoseconds % 10**9)
