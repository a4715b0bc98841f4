"""Cursor on Target 2.0: targets and vehicles as events for ATAK, WinTAK, iTAK and TAK servers.

The fields are those of MITRE's Event schema: ``ce`` is one sigma of the position, and 9999999.0 stands for
unknown. Heights are unknown as well: skysweep knows them above mean sea level, CoT wants them above the
ellipsoid, and the difference of tens of metres is not ours to guess. They are in the remarks instead.
"""

from __future__ import annotations

import math
import uuid
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from xml.etree import ElementTree as ET

import numpy as np

from skysweep.results.exports import FoundTarget, description, ground_targets, xml_document
from skysweep.results.run_folder import CLOCK, CONFIG, Run
from skysweep.types import EventKind

UNKNOWN = "9999999.0"
_SPOT = "b-m-p-s-m"  # a spot marker
_VEHICLE = "a-f-A-M-H-Q"  # friendly unmanned rotary-wing aircraft
_DELETE = "t-x-d-d"  # takes an event off the map
_HOW = "m-g"  # machine, GPS
_SIMULATION = "s-skysweep"  # operation or exercise: a simulation
_ARGB = {EventKind.CONFIRMED: -65536, EventKind.UNCHECKED: -256}  # red and yellow
_TARGET_STALE = timedelta(hours=24)
_VEHICLE_STALE = timedelta(seconds=30)


@dataclass(frozen=True, slots=True)
class CotEvent:
    """One event as XML. ``says`` is all of it but its times: it changes when there is something new."""

    uid: str
    xml: bytes
    says: bytes


def events_of(run: Run, now: datetime) -> list[CotEvent]:
    """The targets of a mission so far.

    Uids depend on the mission alone: an event that is sent again replaces itself. ``now`` is when they are
    sent; ``start`` is when a target was found, where the mission has wall time.
    """
    mission = _mission_id(run)
    return [_target(run, target, mission, now) for target in ground_targets(run)]


def vehicle_event(run: Run, now: datetime) -> CotEvent:
    """Where the vehicle of a mission that flies now was in the newest line that tells it."""
    states = run.states
    latitude, longitude, altitude_m = run.scenario.frame.geodetic_from_enu(states.position_enu_m[-1])[0]
    place = float(latitude), float(longitude)
    event = _event(f"{_mission_id(run)}.vehicle", _VEHICLE, place, UNKNOWN, run.is_simulated)
    detail = ET.SubElement(event, "detail")
    ET.SubElement(detail, "contact", callsign=f"UAV {run.scenario.name}")
    east_mps, north_mps = _velocity_mps(run)
    course_deg = math.degrees(math.atan2(east_mps, north_mps)) % 360.0
    speed = {"course": f"{course_deg:.1f}", "speed": f"{math.hypot(east_mps, north_mps):.1f}"}
    ET.SubElement(detail, "track", speed)
    if np.isfinite(states.battery[-1]):
        ET.SubElement(detail, "status", battery=f"{100.0 * states.battery[-1]:.0f}")
    height = f"{run.altitudes_agl_m[-1]:.0f} m above ground, {altitude_m:.0f} m above mean sea level"
    _remark(detail, run, f"{states.mode[-1]}, {height}")
    return _dated(event, now, now, _VEHICLE_STALE)


def deletion(uid: str, now: datetime) -> CotEvent:
    """Takes the event of this uid off the map: a candidate that turned out to be nothing."""
    event = _event(f"{uid}.delete", _DELETE, (0.0, 0.0), UNKNOWN)
    detail = ET.SubElement(event, "detail")
    ET.SubElement(detail, "link", uid=uid, relation="p-p", type=_SPOT)
    ET.SubElement(detail, "__forcedelete")
    return _dated(event, now, now, _TARGET_STALE)


def events_xml(run: Run, now: datetime) -> bytes:
    """The targets' events in one document."""
    root = ET.Element("events")
    root.extend(ET.fromstring(event.xml) for event in events_of(run, now))
    return xml_document(root)


def uids_of_nothing(run: Run) -> set[str]:
    """Of candidates that may stand on the maps, from this program or an earlier one, and are nothing."""
    mission = _mission_id(run)
    standing = {target.candidate for target in ground_targets(run)}
    may_stand = {
        c.id
        for c in run.candidates
        if c.verdict == EventKind.REJECTED or (run.ended and (c.scanned_s is not None or c.n_sightings > 1))
    }
    return {_uid(mission, k) for k in may_stand - standing}


def _uid(mission: uuid.UUID, candidate: int) -> str:
    return f"{mission}.candidate-{candidate}"


def _mission_id(run: Run) -> uuid.UUID:
    """The same for the same mission: by its configuration, and by when it flew if it flew in real time."""
    first, told = run.records[0], run.events(CLOCK)
    words = [first.get(CONFIG, run.scenario.name), run.seed, told[0]["utc"] if told else ""]
    return uuid.uuid5(uuid.NAMESPACE_OID, "skysweep " + " ".join(map(str, words)))


def _target(run: Run, target: FoundTarget, mission: uuid.UUID, now: datetime) -> CotEvent:
    place = target.latitude_deg, target.longitude_deg
    sigma_m = None if target.radius_95_m is None else target.radius_95_m / math.sqrt(5.991)
    ce = UNKNOWN if sigma_m is None else f"{max(sigma_m, 0.01):.2f}"
    event = _event(_uid(mission, target.candidate), _SPOT, place, ce, run.is_simulated)
    detail = ET.SubElement(event, "detail")
    is_found = target.status == EventKind.CONFIRMED
    name = target.name if is_found else f"candidate {target.candidate}: {target.class_name}?"
    ET.SubElement(detail, "contact", callsign=name)
    argb = str(_ARGB[EventKind(target.status)])
    ET.SubElement(detail, "color", argb=argb)
    ET.SubElement(detail, "usericon", iconsetpath=f"COT_MAPPING_SPOTMAP/{_SPOT}/{argb}")
    height = f"{target.altitude_amsl_m:.0f} m above mean sea level"
    _remark(detail, run, f"{run.scenario.name}: {description(target)}, {height}")
    told = None if target.utc is None else datetime.fromisoformat(target.utc.replace("Z", "+00:00"))
    return _dated(event, now, told or now, _TARGET_STALE)


def _remark(detail: ET.Element, run: Run, words: str) -> None:
    """What is known, in words that also say it where a device does not show ``opex``."""
    ET.SubElement(detail, "remarks").text = f"SIMULATED. {words}" if run.is_simulated else words


def _velocity_mps(run: Run) -> tuple[float, float]:
    """East and north between the last two states."""
    places, times = run.states.position_enu_m[-2:], run.states.time_s[-2:]
    if len(times) < 2 or times[1] <= times[0]:
        return 0.0, 0.0
    east_mps, north_mps = ((places[1, :2] - places[0, :2]) / (times[1] - times[0])).tolist()
    return east_mps, north_mps


def _event(
    uid: str, kind: str, place: tuple[float, float], ce: str, is_simulated: bool = False
) -> ET.Element:
    event = ET.Element("event", version="2.0", uid=uid, type=kind, how=_HOW)
    if is_simulated:
        event.set("opex", _SIMULATION)
    latitude, longitude = place
    lat_lon = {"lat": f"{latitude:.7f}", "lon": f"{longitude:.7f}"}
    ET.SubElement(event, "point", lat_lon | {"hae": UNKNOWN, "ce": ce, "le": UNKNOWN})
    return event


def _dated(event: ET.Element, now: datetime, start: datetime, stale_after: timedelta) -> CotEvent:
    says = ET.tostring(event, encoding="UTF-8")
    event.attrib |= {"time": _zulu(now), "start": _zulu(start), "stale": _zulu(now + stale_after)}
    return CotEvent(event.attrib["uid"], xml_document(event), says)


def _zulu(time: datetime) -> str:
    return time.astimezone(timezone.utc).isoformat(timespec="milliseconds").replace("+00:00", "Z")
