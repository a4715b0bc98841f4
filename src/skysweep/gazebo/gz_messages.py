"""The messages of gz-sim's transport that skysweep uses.

Names, numbers and types are those of gz-msgs 10 and newer (``gz/msgs/*.proto``); unused fields are omitted.
"""

from __future__ import annotations

from skysweep.gazebo.protobuf import message_classes

_DEFINITIONS = """
Time: optional int64 sec = 1, optional int32 nsec = 2
Header: optional Time stamp = 1
Boolean: optional bool data = 2
Vector3d: optional double x = 2, optional double y = 3, optional double z = 4
Quaternion: optional double x = 2, optional double y = 3, optional double z = 4, optional double w = 5
Pose: optional string name = 2, optional Vector3d position = 4, optional Quaternion orientation = 5
WorldControl: optional bool pause = 2, optional uint32 multi_step = 4
Image: optional Header header = 1, optional uint32 width = 2, optional uint32 height = 3, \
optional bytes data = 5, optional uint32 pixel_format_type = 6
"""

Time, Header, Boolean, Vector3d, Quaternion, Pose, WorldControl, Image = message_classes(
    "gz.msgs", "proto3", _DEFINITIONS
).values()
