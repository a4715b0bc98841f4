"""Found and unchecked positions for the ground team: GeoJSON (RFC 7946), KML 2.2 and KMZ, GPX 1.1 and CSV.

What comes from outside, such as a class name, is text in all of them: escaped in XML and HTML, and never a
formula in a table.
"""

from __future__ import annotations

import csv
import html
import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from xml.etree import ElementTree as ET

from skysweep.geometry.grids import mgrs_of, utm_of
from skysweep.results.crops import crop_of, picture_of
from skysweep.results.reporting.wording import probability_of
from skysweep.results.run_folder import PICTURES, CandidateStory, Run
from skysweep.types import EventKind

_DECIMALS_DEG = 7  # 1 cm
_SYMBOLS = {"confirmed": "Flag, Red", "unchecked": "Flag, Blue"}  # of GPX
_COLOURS = {"confirmed": "#FF0000", "unchecked": "#0000FF"}  # of CalTopo
_FORMULA = ("=", "+", "-", "@")  # a cell that begins so may be computed by a spreadsheet


@dataclass(frozen=True, slots=True)
class FoundTarget:
    """One confirmed or unchecked target, for a ground team (WGS 84)."""

    name: str
    candidate: int  # number in the journal
    class_name: str
    latitude_deg: float
    longitude_deg: float
    altitude_amsl_m: float
    confidence: float | None
    radius_95_m: float | None  # the target is inside this circle in 95 of 100 cases
    confirmed_s: float | None  # since take-off
    sightings: int
    status: str  # confirmed or unchecked
    probability: float | None  # that it is a target, where the strategy says one
    seen_from_m: float | None  # lowest height above it from which it was found, up to the verdict
    first_seen_s: float  # since take-off
    utc: str | None  # of its confirmation, or first sighting; None of a simulated mission
    utm: str | None  # zone, easting and northing; None near the poles
    mgrs: str
    picture: str | None  # of it, in the run folder
    by_operator: bool  # the verdict


def found_targets(run: Run) -> list[FoundTarget]:
    """Confirmed candidates in the order of their first confirmation, by which they are numbered for good.

    One that an operator rejects later keeps its number, too: a name that was told is never another's.
    """
    confirmed = {c.id: c for c in run.candidates if c.verdict == EventKind.CONFIRMED}
    told = dict.fromkeys(int(r["candidate"]) for r in run.events(EventKind.CONFIRMED))
    return [_found(run, number, confirmed[k]) for number, k in enumerate(told, start=1) if k in confirmed]


def unchecked_targets(run: Run) -> list[FoundTarget]:
    """Unchecked candidates in the order in which they were first seen."""
    return [_found(run, number, story) for number, story in enumerate(run.unchecked, start=1)]


def ground_targets(run: Run) -> list[FoundTarget]:
    """All of both, confirmed ones first: what the ground team gets."""
    return found_targets(run) + unchecked_targets(run)


def write_exports(run: Run, folder: str | Path) -> list[Path]:
    """Write ``targets.geojson``, ``.kml``, ``.gpx`` and ``.csv`` into a folder and return their paths."""
    folder = Path(folder)
    written = []
    for suffix, content in (("geojson", geojson), ("kml", kml), ("gpx", gpx), ("csv", csv_table)):
        written.append(folder / f"targets.{suffix}")
        written[-1].write_bytes(content(run))
    return written


def geojson(run: Run) -> bytes:
    """A FeatureCollection. Altitude is a property, since RFC 7946 coordinates are above the ellipsoid.

    The properties ``class``, ``title``, ``description`` and ``marker-...`` are those that CalTopo imports.
    """
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [t.longitude_deg, t.latitude_deg]},
            "properties": {
                "class": "Marker",
                "title": t.name,
                "description": description(t),
                "marker-symbol": "point",
                "marker-color": _COLOURS[t.status],
            }
            | {k: v for k, v in asdict(t).items() if k not in ("latitude_deg", "longitude_deg")},
        }
        for t in ground_targets(run)
    ]
    return (json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n").encode()


def kml(run: Run) -> bytes:
    """Placemarks clamped to the ground."""
    return _kml(run, {})


def kmz(run: Run) -> bytes:
    """The same with a picture of each target, cut out around it, in one file."""
    targets = ground_targets(run)
    crops = {t.candidate: crop for t in targets if (crop := crop_of(run, t.candidate)) is not None}
    names = {candidate: f"pictures/candidate-{candidate}.jpg" for candidate in crops}
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        members = {"doc.kml": _kml(run, names)} | {names[c]: crop for c, crop in crops.items()}
        for name, data in members.items():
            archive.writestr(zipfile.ZipInfo(name), data)  # dated 1980, so that it is always the same
    return content.getvalue()


def gpx(run: Run) -> bytes:
    """Waypoints with their height above mean sea level."""
    root = ET.Element("gpx", version="1.1", creator="skysweep", xmlns="http://www.topografix.com/GPX/1/1")
    ET.SubElement(ET.SubElement(root, "metadata"), "name").text = f"{run.scenario.name}: found targets"
    for target in ground_targets(run):
        lat, lon = _degrees(target.latitude_deg), _degrees(target.longitude_deg)
        waypoint = ET.SubElement(root, "wpt", lat=lat, lon=lon)
        ET.SubElement(waypoint, "ele").text = str(target.altitude_amsl_m)
        if target.utc is not None:
            ET.SubElement(waypoint, "time").text = target.utc
        ET.SubElement(waypoint, "name").text = target.name
        ET.SubElement(waypoint, "desc").text = description(target)
        ET.SubElement(waypoint, "sym").text = _SYMBOLS[target.status]
        ET.SubElement(waypoint, "type").text = target.class_name
    return xml_document(root)


def csv_table(run: Run) -> bytes:
    """A line for each, with all that is known."""
    content = io.StringIO(newline="")
    writer = csv.DictWriter(content, [f.name for f in fields(FoundTarget)])
    writer.writeheader()
    for target in ground_targets(run):
        writer.writerow({key: _no_formula(value) for key, value in asdict(target).items()})
    return content.getvalue().encode()


def description(target: FoundTarget) -> str:
    """What is known of a target, in words."""
    parts = ["not checked: have a look"]
    if target.confirmed_s is not None:
        by = " by the operator" * target.by_operator
        parts = [f"confirmed{by} {target.confirmed_s:.0f} s after take-off"]
    if target.utc is not None:
        parts.append(target.utc)
    if target.probability is not None:
        parts.append(probability_words(target))
    if target.confidence is not None:
        parts.append(f"confidence {target.confidence:.2f}")
    if target.radius_95_m is not None:
        parts.append(f"within {target.radius_95_m:.1f} m (95 %)")
    return ", ".join([*parts, f"MGRS {target.mgrs}"])


def _kml(run: Run, pictures: Mapping[int, str]) -> bytes:
    """KML with pictures, by candidate, of these names."""
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = f"{run.scenario.name}: found targets"
    for target in ground_targets(run):
        placemark = ET.SubElement(document, "Placemark")
        ET.SubElement(placemark, "name").text = target.name
        words = description(target)
        if target.candidate in pictures:  # a description is HTML
            words = f'<img src="{pictures[target.candidate]}" width="480"/><br/>{html.escape(words)}'
        ET.SubElement(placemark, "description").text = words
        if target.utc is not None:
            ET.SubElement(ET.SubElement(placemark, "TimeStamp"), "when").text = target.utc
        data = ET.SubElement(placemark, "ExtendedData")
        for key, value in asdict(target).items():
            if value is not None:
                ET.SubElement(ET.SubElement(data, "Data", name=key), "value").text = str(value)
        point = ET.SubElement(placemark, "Point")
        lon, lat = _degrees(target.longitude_deg), _degrees(target.latitude_deg)
        ET.SubElement(point, "coordinates").text = f"{lon},{lat}"
    return xml_document(root)


def _degrees(angle_deg: float) -> str:
    """A latitude, or a longitude of -180 up to but without 180, as GPX and KML have it."""
    return f"{angle_deg if angle_deg < 180.0 else -180.0:.7f}"


def _no_formula(value: object) -> object:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _found(run: Run, number: int, story: CandidateStory) -> FoundTarget:
    latitude, longitude, altitude = run.scenario.frame.geodetic_from_enu(story.position_enu_m)[0]
    class_name = story.class_name or "target"
    radius, confidence, seen_from_m = story.radius_95_m, story.confidence, story.seen_from_m
    utc = run.utc_of(story.first_seen_s if story.verdict_s is None else story.verdict_s)
    picture = picture_of(run, story.id)
    return FoundTarget(
        name=f"{class_name} {number}" if story.verdict else f"unchecked {class_name} {number}",
        candidate=story.id,
        class_name=class_name,
        latitude_deg=round(float(latitude), _DECIMALS_DEG),
        longitude_deg=round(float(longitude), _DECIMALS_DEG),
        altitude_amsl_m=round(float(altitude), 1),
        confidence=None if confidence is None else round(confidence, 3),
        radius_95_m=None if radius is None else round(radius, 2),
        confirmed_s=None if story.verdict_s is None else round(story.verdict_s, 1),
        sightings=story.n_sightings,
        status=story.verdict or EventKind.UNCHECKED,
        probability=story.probability,
        seen_from_m=None if seen_from_m is None else round(seen_from_m, 1),
        first_seen_s=round(story.first_seen_s, 1),
        utc=None if utc is None else f"{utc:%Y-%m-%dT%H:%M:%SZ}",
        utm=utm_of(float(latitude), float(longitude)),
        mgrs=mgrs_of(float(latitude), float(longitude)),
        picture=None if picture is None else f"{PICTURES}/{picture.name}",
        by_operator=story.by_operator,
    )


def probability_words(target: FoundTarget) -> str:
    """The probability of a target that has one, and from how near it was seen."""
    assert target.probability is not None
    near = "" if target.seen_from_m is None else f", seen from {target.seen_from_m:.0f} m and higher"
    return f"probability {probability_of(target.probability)}{near}"


def xml_document(root: ET.Element) -> bytes:
    """The element, which is indented, as a whole document."""
    ET.indent(root)
    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
    return text.encode()
