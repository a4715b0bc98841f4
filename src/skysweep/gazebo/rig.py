"""The camera that we fly in Gazebo Classic: a mount, a 3-axis gimbal (yaw, roll, pitch), a camera.

Nothing of it is visible, has weight or collides. Its world plugin (plugin/gate.cc) moves it.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

from skysweep.gazebo.sdf import pose, tag
from skysweep.geometry.camera import Lens

MODEL = "skysweep_camera"
IMAGE_TOPIC = f"/gazebo/default/{MODEL}/head/camera/image"
POSE_TOPIC = "/gazebo/default/skysweep/camera"
NEAR_M, FAR_M = 0.05, 8000.0
_ARMS = (("yaw", "yaw_arm", "mount", "0 0 1"), ("roll", "roll_arm", "yaw_arm", "1 0 0"))
_HEAD = ("pitch", "head", "roll_arm", "0 1 0")


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
        for name, child, parent, axis in (*_ARMS, _HEAD)
    ]
    links = [_link(name) for name in ("mount", *(child for _, child, _, _ in _ARMS))]
    return tag(
        "model", None, pose((0, 0, 100)), *links, _link("head", camera(lens, rate_hz)), *joints, name=MODEL
    )


def camera(lens: Lens, rate_hz: float) -> ET.Element:
    """A camera sensor with a lens of ours that looks along its link's x."""
    image = tag(
        "image",
        None,
        tag("width", str(lens.width_px)),
        tag("height", str(lens.height_px)),
        tag("format", "R8G8B8"),
    )
    clip = tag("clip", None, tag("near", NEAR_M), tag("far", FAR_M))
    optics = tag("camera", None, tag("horizontal_fov", lens.hfov_rad), image, clip)
    return tag(
        "sensor",
        None,
        tag("always_on", True),
        tag("update_rate", rate_hz),
        optics,
        name="camera",
        type="camera",
    )


def gate(library: Path) -> ET.Element:
    """The plugin that lets the world step only with us."""
    return tag("plugin", None, tag("model", MODEL), name="skysweep_gate", filename=library.name)


def _link(name: str, *parts: ET.Element) -> ET.Element:
    small = {k: 1e-3 for k in ("ixx", "iyy", "izz")}
    inertia = tag("inertia", None, *(tag(k, v) for k, v in small.items()))
    inertial = tag("inertial", None, tag("mass", 0.1), inertia)
    return tag("link", None, tag("gravity", False), inertial, *parts, name=name)
