"""Uploads geofence and rally points of a plan to a PX4 and reads them back."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from mavsdk.exceptions import MavsdkError
from mavsdk.plugins.mission_raw.mission_raw import MissionItem, MissionRaw

from skysweep.errors import UserError
from skysweep.planning.qgc import QgcPlan
from skysweep.vehicles.px4.link import PX4Link

_TRIES = 3
_NEAR_E7 = 2  # of degrees x 1e7: what a round trip may change


def upload_fence_and_rally(link: PX4Link, plan: QgcPlan) -> tuple[int, int]:
    """Uploads both; returns the number of corners and circles, and of rally points.

    If the plan has none of a kind, the vehicle keeps its own. Raises UserError if the vehicle does not store
    them.
    """
    raw = MissionRaw(link.system)
    items = raw.import_qgroundcontrol_mission_from_string(json.dumps(plan.model_dump(mode="json")))
    fence, rally = list(items.geofence_items), list(items.rally_items)
    if fence:
        _upload("geofence", fence, raw.upload_geofence, raw.download_geofence)
    if rally:
        _upload("rally points", rally, raw.upload_rally_points, raw.download_rallypoints)
    return len(fence), len(rally)


def _upload(what: str, items: list[MissionItem], send: Callable[[Any], Any], read: Callable[[], Any]) -> None:
    why = "it reads back differently"
    for _ in range(_TRIES):
        try:
            send(items)
            answer = read()
        except MavsdkError as error:
            why = str(error).partition(";")[0].lower().replace("_", " ")
            continue
        back = answer[1] if isinstance(answer, tuple) else answer
        if len(back) == len(items) and all(map(_same, items, back)):
            return
    raise UserError(f"the vehicle does not store the {what} ({why}); nothing was flown")


def _same(a: MissionItem, b: MissionItem) -> bool:
    return bool(a.command == b.command and abs(a.x - b.x) <= _NEAR_E7 and abs(a.y - b.y) <= _NEAR_E7)
