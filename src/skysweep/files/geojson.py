"""GeoJSON files (RFC 7946) in WGS 84."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from skysweep.errors import UserError
from skysweep.files.json_files import parse_json
from skysweep.files.reading import read_limited

_WGS84_NAMES = re.compile(r"(CRS:?84|EPSG:*(:\d*)?:?4326|WGS ?84)$", re.IGNORECASE)


def read_geojson(path: Path, max_bytes: int) -> Any:
    """The content of a file. Raises UserError where it is no JSON, too large, or not in WGS 84."""
    data = parse_json(read_limited(path, max_bytes), path, "export it again as GeoJSON")
    crs = data.get("crs") if isinstance(data, dict) else None
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if crs is not None and not _WGS84_NAMES.search(str(name)):
        raise UserError(f"{path}: crs: {str(name)[:60]!r} is not WGS 84; export it in EPSG:4326")
    return data
