"""Found and unchecked positions for the ground team: GeoJSON (RFC 7946), KML 2.2, GPX 1.1 and CSV."""

from __future__ import annotations

import csv
import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from xml.etree import ElementTree as ET

from skysweep.results.reporting.wording import probability_of
from skysweep.results.run_folder import CandidateStory, Run
from skysweep.types import EventKind

_DECIMALS_DEG = 7  # 1 cm
_SYMBOLS = {"confirmed": "Flag, Red", "unchecked": "Flag, Blue"}  # of GPX


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
    by_operator: bool  # the verdict


def found_targets(run: Run) -> list[FoundTarget]:
    """Confirmed candidates in the order of their confirmation."""
    confirmed = (c for c in run.candidates if c.verdict == EventKind.CONFIRMED)
    return [_found(run, number, story) for number, story in enumerate(confirmed, start=1)]


def unchecked_targets(run: Run) -> list[FoundTarget]:
    """Unchecked candidates in the order in which they were first seen."""
    return [_found(run, number, story) for number, story in enumerate(run.unchecked, start=1)]


def write_exports(run: Run, folder: str | Path) -> list[Path]:
    """Write ``targets.geojson``, ``.kml``, ``.gpx`` and ``.csv`` into a folder and return their paths."""
    found, folder = found_targets(run) + unchecked_targets(run), Path(folder)
    texts = {
        "targets.geojson": geojson(found),
        "targets.kml": kml(found, run.scenario.name),
        "targets.gpx": gpx(found, run.scenario.name),
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    with (folder / "targets.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(FoundTarget)])
        writer.writeheader()
        writer.writerows(asdict(target) for target in found)
    return [folder / name for name in (*texts, "targets.csv")]


def geojson(found: list[FoundTarget]) -> str:
    """A FeatureCollection. Altitude is a property, since RFC 7946 coordinates are above the ellipsoid."""
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [t.longitude_deg, t.latitude_deg]},
            "properties": {k: v for k, v in asdict(t).items() if k not in ("latitude_deg", "longitude_deg")},
        }
        for t in found
    ]
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def kml(found: list[FoundTarget], title: str) -> str:
    """Placemarks clamped to the ground."""
    root = ET.Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = ET.SubElement(root, "Document")
    ET.SubElement(document, "name").text = f"{title}: found targets"
    for target in found:
        placemark = ET.SubElement(document, "Placemark")
        ET.SubElement(placemark, "name").text = target.name
        ET.SubElement(placemark, "description").text = _description(target)
        data = ET.SubElement(placemark, "ExtendedData")
        for key, value in asdict(target).items():
            if value is not None:
                ET.SubElement(ET.SubElement(data, "Data", name=key), "value").text = str(value)
        point = ET.SubElement(placemark, "Point")
        ET.SubElement(point, "coordinates").text = f"{target.longitude_deg},{target.latitude_deg}"
    return _xml(root)


def gpx(found: list[FoundTarget], title: str) -> str:
    """Waypoints with their height above mean sea level."""
    root = ET.Element("gpx", version="1.1", creator="skysweep", xmlns="http://www.topografix.com/GPX/1/1")
    ET.SubElement(ET.SubElement(root, "metadata"), "name").text = f"{title}: found targets"
    for target in found:
        waypoint = ET.SubElement(root, "wpt", lat=str(target.latitude_deg), lon=str(target.longitude_deg))
        ET.SubElement(waypoint, "ele").text = str(target.altitude_amsl_m)
        ET.SubElement(waypoint, "name").text = target.name
        ET.SubElement(waypoint, "desc").text = _description(target)
        ET.SubElement(waypoint, "sym").text = _SYMBOLS[target.status]
        ET.SubElement(waypoint, "type").text = target.class_name
    return _xml(root)


def _found(run: Run, number: int, story: CandidateStory) -> FoundTarget:
    latitude, longitude, altitude = run.scenario.frame.geodetic_from_enu(story.position_enu_m)[0]
    class_name = story.class_name or "target"
    radius, confidence, seen_from_m = story.radius_95_m, story.confidence, story.seen_from_m
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
        by_operator=story.by_operator,
    )


def probability_words(target: FoundTarget) -> str:
    """The probability of a target that has one, and from how near it was seen."""
    assert target.probability is not None
    near = "" if target.seen_from_m is None else f", seen from {target.seen_from_m:.0f} m and higher"
    return f"probability {probability_of(target.probability)}{near}"


def _description(target: FoundTarget) -> str:
    parts = ["not checked: have a look"]
    if target.confirmed_s is not None:
        by = " by the operator" * target.by_operator
        parts = [f"confirmed{by} {target.confirmed_s:.0f} s after take-off"]
    if target.probability is not None:
        parts.append(probability_words(target))
    if target.confidence is not None:
        parts.append(f"confidence {target.confidence:.2f}")
    if target.radius_95_m is not None:
        parts.append(f"within {target.radius_95_m:.1f} m (95 %)")
    return ", ".join(parts)


def _xml(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
