"""Whether the files of a scenario's ground are still the ones that it was flown over."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

from skysweep.errors import UserError
from skysweep.files.reading import stamp_of
from skysweep.scenarios.files import ground_files
from skysweep.scenarios.model import Scenario
from skysweep.worlds.rasters import opened

_CHUNK_BYTES = 2**24


def ground_digest(scenario: Scenario) -> str | None:
    """SHA-256 in hexadecimal of all files of the ground, and of those beside them that GDAL reads with them.

    None where there are no files. Files that have not changed are read once. Raises UserError where one is
    missing, MissingExtraError where rasterio is.
    """
    given = ground_files(scenario)
    if not given:
        return None
    digests = []
    for field, path in sorted(given.items()):
        files = [str(path)]
        if not field.endswith("_file"):
            with opened(path, field) as raster:
                files = sorted(raster.files)
        digests += [_digest(field, Path(file), stamp_of(Path(file))) for file in files]
    return hashlib.sha256(" ".join(digests).encode()).hexdigest()


@lru_cache(maxsize=64)
def _digest(field: str, path: Path, _stamp: tuple[int, int] | None) -> str:
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK_BYTES):
                digest.update(chunk)
    except OSError as error:
        raise UserError(f"{field}: {path}: cannot be read ({error.strerror}); check the path") from None
    return digest.hexdigest()
