"""Shapes from GeoJSON files."""

import json

import pytest
import shapely

from skysweep.errors import UserError
from skysweep.geometry.frames import LocalFrame
from skysweep.planning.prior.features import read_features

FRAME = LocalFrame(60.2, 22.1)
TRAIL = {"type": "LineString", "coordinates": [[22.1, 60.2], [22.11, 60.2]]}
LAKE = {"type": "Polygon", "coordinates": [[[22.1, 60.2], [22.12, 60.2], [22.12, 60.21], [22.1, 60.2]]]}


def written(tmp_path, content):
    path = tmp_path / "shapes.geojson"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_shapes_of_all_kinds_come_to_lie_where_they_are(tmp_path):
    feature = {"type": "Feature", "properties": {"name": "trail"}, "geometry": TRAIL}
    nested = {"type": "Feature", "geometry": {"type": "GeometryCollection", "geometries": [LAKE]}}
    content = {"type": "FeatureCollection", "features": [feature, nested]}
    shapes = read_features(written(tmp_path, content), FRAME)
    west, south, east, north = shapes.bounds
    assert (west, south) == pytest.approx((0.0, 0.0), abs=0.1)
    assert (east, north) == pytest.approx((1110, 1114), abs=5)
    assert shapely.dwithin(shapes, shapely.Point(300.0, 3.0), 5.0)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("{", "ends too early"),
        ({"type": "Trail"}, "no GeoJSON of shapes"),
        ([1, 2], "no GeoJSON of shapes"),
        ({"type": "FeatureCollection", "features": []}, "holds no shape"),
        ({"type": "LineString", "coordinates": [[450000, 6670000], [450010, 6670010]]}, "WGS 84"),
        ({**TRAIL, "crs": {"properties": {"name": "EPSG:3067"}}}, "not WGS 84"),
    ],
)
def test_bad_shapes_are_told_in_one_sentence(tmp_path, content, word):
    with pytest.raises(UserError, match=word) as told:
        read_features(written(tmp_path, content), FRAME)
    assert str(told.value).startswith(str(tmp_path))


def test_another_kind_of_file_is_refused(tmp_path):
    with pytest.raises(UserError, match="is no GeoJSON; save"):
        read_features(tmp_path / "trails.gpx", FRAME)
