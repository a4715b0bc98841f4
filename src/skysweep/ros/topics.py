"""The topics of a mission: names, types and qualities of service.

- ``SENSOR`` (best effort, the newest 5): pictures; a late picture is worth less than the next one.
- ``EVENT`` (reliable, the newest 50): messages that must reach everyone who listens now.
- ``LATCHED`` (reliable, transient local, the newest 1): messages that late joiners need too.

Names are relative to the node's namespace, except those that all of ROS shares.
"""

from __future__ import annotations

from dataclasses import dataclass

import yaml

from skysweep.ros import messages as m

NAMESPACE = "/skysweep"


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of service."""

    depth: int
    reliable: bool
    latched: bool


@dataclass(frozen=True, slots=True)
class Topic:
    """A name, relative or absolute, with its type and quality."""

    name: str
    type_name: str
    quality: Quality

    @property
    def full_name(self) -> str:
        """The absolute name without remapping."""
        return self.name if self.name.startswith("/") else f"{NAMESPACE}/{self.name}"


SENSOR = Quality(5, reliable=False, latched=False)
EVENT = Quality(50, reliable=True, latched=False)
LATCHED = Quality(1, reliable=True, latched=True)

TF = Topic("/tf", m.TF, Quality(100, reliable=True, latched=False))
TF_STATIC = Topic("/tf_static", m.TF, LATCHED)
CLOCK = Topic("/clock", "rosgraph_msgs/msg/Clock", Quality(1, reliable=False, latched=False))
IMAGE = Topic("camera/image_raw", m.IMAGE, SENSOR)
COMPRESSED_IMAGE = Topic("camera/image_raw/compressed", m.COMPRESSED_IMAGE, SENSOR)
ANNOTATIONS = Topic("camera/annotations", m.ANNOTATIONS, SENSOR)
EVIDENCE = Topic("evidence/compressed", m.COMPRESSED_IMAGE, EVENT)
CAMERA_INFO = Topic("camera/camera_info", m.CAMERA_INFO, SENSOR)
DETECTIONS = Topic("detections", m.DETECTIONS, EVENT)
STANDARD_DETECTIONS = Topic("detections_standard", m.MARKERS, EVENT)
ODOMETRY = Topic("odometry", m.ODOMETRY, EVENT)
POSE = Topic("pose", "geometry_msgs/msg/PoseStamped", EVENT)
FIX = Topic("fix", "sensor_msgs/msg/NavSatFix", EVENT)
ALTITUDE = Topic("altitude_agl", "std_msgs/msg/Float64", EVENT)
BATTERY = Topic("battery", "sensor_msgs/msg/BatteryState", EVENT)
STATE = Topic("state", "std_msgs/msg/String", LATCHED)
JOURNAL = Topic("journal", "std_msgs/msg/String", EVENT)
PLANNED_PATH = Topic("planned_path", m.PATH, LATCHED)
FLOWN_PATH = Topic("flown_path", m.PATH, LATCHED)
TARGETS = Topic("targets", m.MARKERS, LATCHED)
WORLD = Topic("world", m.MARKERS, LATCHED)
MOVING = Topic("moving", m.MARKERS, LATCHED)
VEHICLE = Topic("vehicle", m.MARKERS, LATCHED)
GEOJSON = Topic("geojson", m.GEOJSON, LATCHED)
ROSOUT = Topic("/rosout", m.LOG, EVENT)


def rosbag_profile(quality: Quality) -> str:
    """The YAML text that rosbag2 stores with a topic, so that a replay offers the same quality."""
    forever = {"sec": 9223372036, "nsec": 854775807}
    profile = {
        "history": "keep_last",
        "depth": quality.depth,
        "reliability": "reliable" if quality.reliable else "best_effort",
        "durability": "transient_local" if quality.latched else "volatile",
        "deadline": forever,
        "lifespan": forever,
        "liveliness": "automatic",
        "liveliness_lease_duration": forever,
        "avoid_ros_namespace_conventions": False,
    }
    return str(yaml.safe_dump([profile], sort_keys=False)).strip()
