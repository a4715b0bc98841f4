"""The camera that a mission flies in Gazebo Classic: a mount, a 3-axis gimbal (yaw, roll, pitch), a camera.

It is invisible, weightless and cannot collide. A world plugin (plugin/gate.cc) moves it.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

from skysweep.gazebo.sdf import pose, tag
from skysweep.geometry.camera import Lens

MODEL = "skysweep_camera"
IMAGE_TOPIC = f"/gazebo/default/{MODEL}/head/camera/image"
POSE_TOPIC = "/gazebo/default/skysweep/camera"
NEAR_M, FAR_M = 0.05, 8000.0
_LINKS = ("mount", "yaw_arm", "roll_arm", "head")
_JOINTS = (("yaw", "0 0 1"), ("roll", "1 0 0"), ("pitch", "0 1 0"))  # from each link to the next


def camera_rig(lens: Lens, rate_hz: float) -> ET.Element:
    """The model."""
    joints = [
        tag(
            "joint",
            None,
            tag("parent", parent),
            tag("child", child),
            tag("axis", None, tag("xyz", axis), tag("limit", None, tag("lower", -1e16), tag("upper", 1e16))),
            name=name,
            type="revolute",
        )
        for (name, axis), (parent, child) in zip(_JOINTS, pairwise(_LINKS), strict=True)
    ]
    links = [_link(name) for name in _LINKS]
    links[-1].append(camera(lens, rate_hz))
    return tag("model", None, pose((0, 0, 100)), *links, *joints, name=MODEL)


def camera(lens: Lens, rate_hz: float) -> ET.Element:
    """A camera sensor with this lens that looks along its link's x."""
    size = tag("width", str(lens.width_px)), tag("height", str(lens.height_px))
    image = tag("image", None, *size, tag("format", "R8G8B8"))
    clip = tag("clip", None, tag("near", NEAR_M), tag("far", FAR_M))
    optics = tag("camera", None, tag("horizontal_fov", lens.hfov_rad), image, clip)
    parts = tag("always_on", True), tag("update_rate", rate_hz), optics
    return tag("sensor", None, *parts, name="camera", type="camera")


def gate(library: Path) -> ET.Element:
    """The plugin that lets the world step only with the mission."""
    return tag("plugin", None, tag("model", MODEL), name="skysweep_gate", filename=library.name)


def _link(name: str) -> ET.Element:
    inertia = tag("inertia", None, *(tag(axis, 1e-3) for axis in ("ixx", "iyy", "izz")))
    inertial = tag("inertial", None, tag("mass", 0.1), inertia)
    return tag("link", None, tag("gravity", False), inertial, name=name)
