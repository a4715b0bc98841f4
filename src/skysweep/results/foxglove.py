"""A layout for Foxglove that shows a recording: 3-D scene, map, picture with boxes, plots, modes and events.

Panel types and settings are those of the layout files that Foxglove exports and imports (``configById`` and a
tree of splits).
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from skysweep.ros import messages as m
from skysweep.ros import topics
from skysweep.ros.topics import Topic

LAYOUT_FILE = "foxglove-layout.json"

_SCENE = (
    topics.TARGETS,
    topics.WORLD,
    topics.VEHICLE,
    topics.PLANNED_PATH,
    topics.FLOWN_PATH,
    topics.CAMERA_INFO,
)


def layout_json(has_film: bool, has_movers: bool) -> str:
    """The layout as JSON. Without a film, the picture's panel shows the evidence kept of candidates."""
    scene, place, picture = "3D!scene", "map!place", "Image!picture"
    altitude, battery, modes, events = (
        "Plot!altitude",
        "Plot!battery",
        "StateTransitions!mode",
        "RosOut!events",
    )
    panels: dict[str, Any] = {
        scene: _scene((*_SCENE, topics.MOVING) if has_movers else _SCENE),
        place: {"layer": "map", "followTopic": "", "zoomLevel": 17, "topicColors": {}, "disabledTopics": []},
        picture: {
            "imageMode": _picture(has_film),
            "scene": {"transforms": {"enablePreloading": True}},
            "foxglovePanelTitle": "What the detector sees",
        },
        altitude: _plot("Altitude above ground (m)", topics.ALTITUDE, "data"),
        battery: _plot("Battery (share left)", topics.BATTERY, "percentage"),
        modes: {
            "paths": [{"value": f"{topics.STATE.full_name}.data", "timestampMethod": "receiveTime"}],
            "isSynced": True,
            "foxglovePanelTitle": "Mode",
        },
        events: {"topicToRender": topics.ROSOUT.full_name, "minLogLevel": 1, "searchTerms": []},
    }
    upper = _split("row", scene, _split("column", place, picture, 50), 58)
    lower = _split("row", _split("column", altitude, _split("row", modes, battery, 50), 50), events, 58)
    layout = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 5},
        "layout": _split("column", upper, lower, 64),
    }
    return json.dumps(layout, indent=1) + "\n"


def _scene(shown: Iterable[Topic]) -> dict[str, Any]:
    view = {"perspective": True, "distance": 70, "phi": 55, "thetaOffset": 40, "fovy": 45}
    aim = {"target": [0, 0, 0], "targetOffset": [0, 0, 0], "targetOrientation": [0, 0, 0, 1]}
    visible: dict[str, dict[str, Any]] = {topic.full_name: {"visible": True} for topic in shown}
    frustum = {"distance": 8, "planarProjectionFactor": 1, "width": 0.12, "color": "#d97706"}  # m
    visible[topics.CAMERA_INFO.full_name] |= frustum
    transforms = {"showLabel": False, "axisScale": 0, "lineWidth": 0, "enablePreloading": True}
    grid = {"layerId": "foxglove.Grid", "frameId": m.MAP, "size": 400, "divisions": 40, "color": "#8888883c"}
    return {
        "cameraState": view | aim | {"near": 0.5, "far": 5000},
        "followMode": "follow-position",
        "followTf": m.BASE,
        "scene": {"transforms": transforms},
        "transforms": {},
        "topics": visible,
        "layers": {"grid": {"instanceId": "grid", "visible": True, "label": "10 m"} | grid},
        "imageMode": {},
    }


def _picture(has_film: bool) -> dict[str, Any]:
    if not has_film:
        return {"imageTopic": topics.EVIDENCE.full_name}
    return {
        "imageTopic": topics.COMPRESSED_IMAGE.full_name,
        "calibrationTopic": topics.CAMERA_INFO.full_name,
        "annotations": {topics.ANNOTATIONS.full_name: {"visible": True}},
        "synchronize": True,
    }


def _plot(title: str, topic: Topic, field: str) -> dict[str, Any]:
    value = f"{topic.full_name}.{field}"
    path = {"value": value, "enabled": True, "timestampMethod": "receiveTime", "label": title}
    return {
        "paths": [path],
        "foxglovePanelTitle": title,
        "showLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
        "xAxisVal": "timestamp",
    }


def _split(direction: str, first: Any, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}
