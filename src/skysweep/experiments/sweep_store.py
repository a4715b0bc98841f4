"""The results of a sweep in a folder: parts while it runs, one table when it is complete.

``missions.parquet`` has one row a mission and the same bytes however the sweep ran; ``timings.parquet``
has what differs from run to run.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from typing import Any

import polars as pl

from skysweep.errors import UserError
from skysweep.experiments.folder import Folder

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
        content = self._folder.read(SPEC_FILE)
        if content is None and self._folder.read(TABLE_FILE) is not None:
            raise UserError(f"{self._folder}: holds a {TABLE_FILE} and no {SPEC_FILE}; write another --out")
        return None if content is None else content.decode("utf-8")

    def write_spec(self, text: str) -> None:
        """Keep the spec beside its results."""
        self._folder.write(SPEC_FILE, text.encode("utf-8"))

    def known(self) -> pl.DataFrame:
        """Scenario, config_hash and error of every mission that is finished."""
        return self._outcomes([*KEY, "error"])

    def is_complete(self) -> bool:
        """Whether the table is there and nothing waits to join it."""
        return self._folder.read(TABLE_FILE) is not None and not self._folder.names(PARTS)

    def append(self, rows: Sequence[dict[str, Any]]) -> None:
        """Write finished missions down, as one part."""
        part = pl.DataFrame(rows, schema=_SCHEMA, orient="row")
        name = hashlib.sha256("".join(part["scenario"] + part["config_hash"]).encode()).hexdigest()[:16]
        self._folder.write(f"{PARTS}/{name}.parquet", _parquet(part))

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
        self._folder.write(TIMINGS_FILE, _parquet(table.select("job", *TIMINGS)))
        self._folder.write(TABLE_FILE, _parquet(table.drop(*TIMINGS)))
        self._folder.remove(PARTS)

    def _outcomes(self, columns: list[str]) -> pl.DataFrame:
        """These columns of every finished mission, from the parts and the table.

        A mission that failed and was flown again stands there twice; what counts is where it did not fail.
        """
        frames = [_read(self._folder, name).select(columns) for name in self._folder.names(PARTS)]
        content = self._folder.read(TABLE_FILE)
        if content is not None:
            table = _read(self._folder, TABLE_FILE)
            timings = _read(self._folder, TIMINGS_FILE)
            frames.append(table.join(timings, on="job", how="left").select(columns))
        empty = pl.DataFrame(schema={name: _SCHEMA[name] for name in columns})
        failed_last = pl.concat([empty, *frames]).sort(pl.col("error").is_not_null(), maintain_order=True)
        return failed_last.unique(KEY, keep="first", maintain_order=True)


def _parquet(frame: pl.DataFrame) -> bytes:
    """The same bytes for the same rows."""
    content = io.BytesIO()
    frame.write_parquet(content, compression="zstd", compression_level=3, row_group_size=100_000)
    return content.getvalue()


def _read(folder: Folder, name: str) -> pl.DataFrame:
    content = folder.read(name)
    try:
        return pl.read_parquet(io.BytesIO(content or b""))
    except (pl.exceptions.PolarsError, OSError):
        raise UserError(
            f"{folder.where(name)}: is damaged or missing; delete it, or write another --out"
        ) from None
