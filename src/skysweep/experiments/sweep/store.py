"""The results of a sweep in a folder: parts while it runs, one table when it is complete.

``missions.parquet`` has one row a mission and the same bytes however the sweep ran; ``timings.parquet``
has what differs from run to run. ``SHA256SUMS`` has their digests and that of ``spec.yaml``; a part is named
by its own. What does not have its digest any more is refused.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import polars as pl

from skysweep.errors import UserError
from skysweep.files.folder import Folder
from skysweep.results.checksums import (
    SUMS_FILE,
    Sums,
    dump_sums,
    read_sums,
    refuse_changed,
    refuse_misnamed,
    sha256,
)

SPEC_FILE = "spec.yaml"
TABLE_FILE = "missions.parquet"
TIMINGS_FILE = "timings.parquet"
PARTS = "parts"

KEY = ("scenario", "config_hash")

_NUMBERS = pl.List(pl.Float64)

# Every key of a mission's summary but those that the matrix knows (scenario, strategy, seed, sensor).
METRICS: dict[str, pl.DataType | type[pl.DataType]] = {
    "n_c": pl.Float64,
    "d_c_m": pl.Float64,
    "completed": pl.Boolean,
    "end_reason": pl.String,
    "mission_time_s": pl.Float64,
    "scan_only_time_s": pl.Float64,
    "return_time_s": pl.Float64,
    "total_time_s": pl.Float64,
    "n_targets": pl.Int64,
    "n_confirmed": pl.Int64,
    "recall": pl.Float64,
    "time_to_confirm_s": _NUMBERS,
    "pos_time_s": _NUMBERS,
    "pos_value": _NUMBERS,
    "n_scanned": pl.Int64,
    "n_checks": pl.Int64,
    "n_checked": pl.Int64,
    "false_scans": pl.Int64,
    "false_positives": pl.Int64,
    "duplicates": pl.Int64,
    "wrong_rejections": pl.Int64,
    "median_localisation_error_m": pl.Float64,
    "path_length_m": pl.Float64,
    "vertical_m": pl.Float64,
    "energy_wh": pl.Float64,
    "total_energy_wh": pl.Float64,
    "battery_remaining": pl.Float64,
    "area_m2": pl.Float64,
    "area_covered": pl.Float64,
    "area_covered_m2": pl.Float64,
    "collisions": pl.Int64,
    "min_clearance_m": pl.Float64,
}
TIMINGS = {"wall_time_s": pl.Float64, "real_time_factor": pl.Float64}
_SCHEMA = {"scenario": pl.String, "config_hash": pl.String, **METRICS, "error": pl.String, **TIMINGS}


def outcome(
    label: str, config_hash: str, summary: dict[str, Any] | None, error: str | None
) -> dict[str, Any]:
    """The row of a mission: its summary flattened, or all nulls and the error."""
    row: dict[str, Any] = dict.fromkeys(_SCHEMA)
    row |= {"scenario": label, "config_hash": config_hash, "error": error}
    if summary is not None:
        curve = summary["pos_curve"] or ()
        flat = summary | {"pos_time_s": [t for t, _ in curve], "pos_value": [p for _, p in curve]}
        flat |= {key: float(summary[key]) for key in ("n_c", "d_c_m")}
        row |= {key: flat[key] for key in [*METRICS, *TIMINGS]}
    return row


class SweepStore:
    """Reads and writes the results in ``folder``. Nothing is ever half-written."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def spec(self) -> str | None:
        """The stored spec's text. Raises UserError where there are results and no spec."""
        content = self._checked(SPEC_FILE)
        if content is None and self._folder.read(TABLE_FILE) is not None:
            raise UserError(f"{self._folder}: holds a {TABLE_FILE} and no {SPEC_FILE}; write another --out")
        return None if content is None else content.decode("utf-8")

    def write_spec(self, text: str) -> None:
        """Keep the spec beside its results."""
        self._replace({SPEC_FILE: text.encode("utf-8")})

    def known(self) -> pl.DataFrame:
        """Scenario, config_hash and error of every mission that is finished."""
        return self._outcomes([*KEY, "error"])

    def is_complete(self) -> bool:
        """Whether the table is there and nothing waits to join it."""
        return self._folder.read(TABLE_FILE) is not None and not self._folder.names(PARTS)

    def append(self, rows: Sequence[dict[str, Any]]) -> None:
        """Write finished missions down, as one part."""
        part = _parquet(pl.DataFrame(rows, schema=_SCHEMA, orient="row"))
        self._folder.write(f"{PARTS}/{sha256(part)}.parquet", part)

    def finish(self, matrix: pl.DataFrame) -> None:
        """Make the table from the parts and remove them. ``matrix`` has one row for each mission.

        Raises UserError where a mission is missing, because somebody removed parts.
        """
        table = matrix.join(self._outcomes(list(_SCHEMA)), on=KEY, how="inner", maintain_order="left")
        if len(table) < len(matrix):
            raise UserError(
                f"{self._folder}: {len(matrix) - len(table)} missions were removed while the sweep ran; "
                "give the same command again"
            )
        timings, metrics = table.select("job", *TIMINGS), table.drop(*TIMINGS)
        self._replace({TIMINGS_FILE: _parquet(timings), TABLE_FILE: _parquet(metrics)})
        self._folder.remove(PARTS)

    def _outcomes(self, columns: list[str]) -> pl.DataFrame:
        """These columns of every finished mission, from the parts and the table.

        A mission that failed and was flown again stands there twice; what counts is where it did not fail.
        """
        frames = [self._part(name).select(columns) for name in self._folder.names(PARTS)]
        if self._folder.read(TABLE_FILE) is not None:
            table, timings = self._table(TABLE_FILE), self._table(TIMINGS_FILE)
            frames.append(table.join(timings, on="job", how="left").select(columns))
        empty = pl.DataFrame(schema={name: _SCHEMA[name] for name in columns})
        failed_last = pl.concat([empty, *frames]).sort(pl.col("error").is_not_null(), maintain_order=True)
        return failed_last.unique(KEY, keep="first", maintain_order=True)

    def _table(self, name: str) -> pl.DataFrame:
        return _read(self._checked(name) or b"", self._folder.where(name))

    def _part(self, name: str) -> pl.DataFrame:
        content, where = self._folder.read(name) or b"", self._folder.where(name)
        refuse_misnamed(name, content, where)
        return _read(content, where)

    def _checked(self, name: str) -> bytes | None:
        """What is in a file; None where there is none. Raises UserError where it is damaged."""
        content = self._folder.read(name)
        if content is not None:
            refuse_changed(self._sums(), name, content, self._folder.where(name))
        return content

    def _sums(self) -> Sums | None:
        content = self._folder.read(SUMS_FILE)
        return None if content is None else read_sums(content, self._folder.where(SUMS_FILE))

    def _replace(self, contents: Mapping[str, bytes]) -> None:
        """Write files and their digests; a kill in between leaves nothing that would be refused."""
        sums = self._sums()
        if sums is None:
            found = {name: self._folder.read(name) for name in (SPEC_FILE, TABLE_FILE, TIMINGS_FILE)}
            sums = {name: frozenset([sha256(old)]) for name, old in found.items() if old is not None}
        new = {name: frozenset([sha256(content)]) for name, content in contents.items()}
        both = {name: sums.get(name, frozenset()) | digest for name, digest in new.items()}
        self._folder.write(SUMS_FILE, dump_sums({**sums, **both}))
        for name, content in contents.items():
            self._folder.write(name, content)
        self._folder.write(SUMS_FILE, dump_sums({**sums, **new}))


def _parquet(frame: pl.DataFrame) -> bytes:
    """The same bytes for the same rows."""
    content = io.BytesIO()
    frame.write_parquet(content, compression="zstd", compression_level=3, row_group_size=100_000)
    return content.getvalue()


def _read(content: bytes, where: str) -> pl.DataFrame:
    try:
        return pl.read_parquet(io.BytesIO(content))
    except (pl.exceptions.PolarsError, OSError):
        raise UserError(f"{where}: is damaged or missing; delete it, or write another --out") from None
