from __future__ import annotations

import csv
import io
import json

import defusedxml.ElementTree as ET
import pytest

from skysweep.results.exports import found_targets, write_exports

KML = "{http://www.opengis.net/kml/2.2}"
GPX = "{http://www.topografix.com/GPX/1/1}"


@pytest.fixture
def files(tiny_run, tmp_path):
    return {path.suffix: path.read_text(encoding="utf-8") for path in write_exports(tiny_run, tmp_path)}


def test_confirmed_candidates_in_their_order(tiny_run):
    found = found_targets(tiny_run)
    assert [t.name for t in found] == ["stop sign 1", "stop sign 2", "stop sign 3", "stop sign 4"]
    assert [t.confirmed_s for t in found] == [16, 40, 44, 50]
    assert found[0].confidence == 0.8
    # 10 m north and 5.5 m east of 60.449 N 22.2966 E: 111.4 km and 55.0 km a degree there
    assert found[0].latitude_deg == pytest.approx(60.4490 + 10 / 111_412, abs=2e-7)
    assert found[0].longitude_deg == pytest.approx(22.2966 + 5.5 / 55_045, abs=2e-7)


def test_every_format_has_the_same_places(files):
    features = json.loads(files[".geojson"])["features"]
    from_geojson = [tuple(f["geometry"]["coordinates"]) for f in features]
    kml = ET.fromstring(files[".kml"])
    from_kml = [tuple(map(float, c.text.split(","))) for c in kml.iter(f"{KML}coordinates")]
    gpx = ET.fromstring(files[".gpx"])
    from_gpx = [(float(w.get("lon")), float(w.get("lat"))) for w in gpx.iter(f"{GPX}wpt")]
    rows = list(csv.DictReader(io.StringIO(files[".csv"])))
    from_csv = [(float(r["longitude_deg"]), float(r["latitude_deg"])) for r in rows]
    assert len(from_geojson) == 4
    assert from_geojson == from_kml == from_gpx == from_csv


def test_geojson_points_are_flat_and_carry_what_is_known(files):
    first = json.loads(files[".geojson"])["features"][0]
    assert len(first["geometry"]["coordinates"]) == 2
    assert first["properties"]["class_name"] == "stop sign"
    assert first["properties"]["altitude_amsl_m"] == 30.0
    assert first["properties"]["radius_95_m"] is None


def test_gpx_elements_stand_in_the_order_of_the_schema(files):
    waypoint = next(ET.fromstring(files[".gpx"]).iter(f"{GPX}wpt"))
    assert [child.tag.removeprefix(GPX) for child in waypoint] == ["ele", "name", "desc", "sym", "type"]
