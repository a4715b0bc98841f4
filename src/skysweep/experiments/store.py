"""Missions in a folder: parts while they are flown, one table when they are complete.

``missions.parquet`` has one row per mission and the same bytes however it was flown. ``timings.parquet`` has
the values that differ from run to run. ``SHA256SUMS`` has their digests and that of a sweep's ``spec.yaml``;
a part is named by its own digest. A file that does not match its digest is refused.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, cast, get_args, get_type_hints

import polars as pl

from skysweep.errors import UserError
from skysweep.files.folder import Folder
from skysweep.results import checksums
from skysweep.results.checksums import SUMS_FILE, Sums, sha256
from skysweep.results.run_folder import JOURNAL_FILE, SPEC_FILE, TABLE_FILE
from skysweep.results.summary import Summary, finite_or_inf

TIMINGS_FILE = "timings.parquet"
PARTS = "parts"
OLDER_FILE = "missions.jsonl"  # comparisons and tuning kept missions there before they had tables

KEY = ("scenario", "config_hash")
MATRIX_COLUMNS = ("scenario", "strategy", "seed", "sensor")  # of a summary, known to the matrix
TIMINGS = ("wall_time_s", "real_time_factor")

_PART_SHARE, _PART_S = 0.05, (1.0, 30.0)  # a part is written after this share of the time so far
_PART_ROWS = 2000

Row = dict[str, Any]
_Schema = dict[str, pl.DataType | type[pl.DataType]]


def _columns_of_summaries() -> _Schema:
    """The columns of a summary that are in no matrix and no timings. The curve is two lists."""
    scalars = {float: pl.Float64, str: pl.String, bool: pl.Boolean, int: pl.Int64}
    columns: _Schema = {}
    for key, kind in get_type_hints(Summary).items():
        if key not in (*MATRIX_COLUMNS, *TIMINGS):
            kinds = {kind, *get_args(kind)}
            dtype = next((d for scalar, d in scalars.items() if scalar in kinds), pl.List(pl.Float64))
            columns |= dict.fromkeys(("pos_time_s", "pos_value") if key == "pos_curve" else (key,), dtype)
    return columns


SUMMARY_COLUMNS = _columns_of_summaries()
_SCHEMA: _Schema = {
    **dict.fromkeys(KEY, pl.String),
    **SUMMARY_COLUMNS,
    "error": pl.String,
    **dict.fromkeys(TIMINGS, pl.Float64),
}


def row_of(label: str, config_hash: str, summary: Summary | None, error: str | None = None) -> Row:
    """The row of a mission: its flattened summary, or nulls and the error."""
    row: Row = dict.fromkeys(_SCHEMA)
    if summary is not None:
        curve = summary["pos_curve"] or ()
        flat = summary | {"pos_time_s": [t for t, _ in curve], "pos_value": [p for _, p in curve]}
        flat |= {"n_c": float(summary["n_c"]), "d_c_m": float(summary["d_c_m"])}
        row |= {key: flat[key] for key in [*SUMMARY_COLUMNS, *TIMINGS]}
    return row | {"scenario": label, "config_hash": config_hash, "error": error}


def summary_of(row: Row) -> Summary:
    """The summary behind a row of a comparison. What an older skysweep did not count is None."""
    curve = [list(point) for point in zip(row["pos_time_s"], row["pos_value"], strict=True)]
    limits = {key: finite_or_inf(row[key]) for key in ("n_c", "d_c_m")}
    told = {**row, **limits, "pos_curve": curve or None}
    return cast("Summary", {key: told.get(key) for key in Summary.__annotations__})


def numbered(outcomes: pl.DataFrame) -> pl.DataFrame:
    """The missions of a comparison with a number, ``job``, that is independent of the order of flight."""
    order = ["scenario", "strategy", *_parameters(outcomes), "sensor", "seed", "config_hash"]
    return outcomes.sort(order).with_row_index("job").cast({"job": pl.Int64})


class MissionStore:
    """Reads and writes the missions in ``folder``. Nothing is ever half-written."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def refuse_run(self) -> None:
        """Raises UserError where the folder holds one mission, of which commands would tell instead."""
        if self._folder.exists(JOURNAL_FILE):
            raise UserError(f"{self._folder}: holds a mission; write another --out")

    def spec(self) -> str | None:
        """The text of a sweep's spec, if there is one."""
        content = self._checked(SPEC_FILE)
        return None if content is None else content.decode("utf-8")

    def write_spec(self, text: str) -> None:
        self._replace({SPEC_FILE: text.encode("utf-8")})

    def known(self) -> pl.DataFrame:
        """Scenario, config_hash and error of each finished mission."""
        return self.outcomes([*KEY, "error"])

    def summaries(self) -> dict[str, Summary]:
        """The summaries of a comparison by config_hash. Raises UserError where the missions are a sweep's."""
        rows = self.outcomes()
        told = "strategy" in rows.columns and not rows["error"].count()
        if self.spec() is not None or (len(rows) and not told):
            raise UserError(f"{self._folder}: holds a sweep; write another --out")
        return {row["config_hash"]: summary_of(row) for row in rows.iter_rows(named=True)}

    def has_table(self) -> bool:
        return self._folder.exists(TABLE_FILE)

    def has_parts(self) -> bool:
        return bool(self._folder.names(PARTS))

    def is_complete(self) -> bool:
        return self.has_table() and not self.has_parts()

    def append(self, rows: Sequence[Row], matrix: pl.DataFrame | None = None) -> None:
        """Write finished missions as one part, with the columns that ``matrix`` has of them."""
        part = pl.DataFrame(rows, schema=_SCHEMA, orient="row")
        if matrix is not None:
            part = matrix.drop("job").join(part, on=KEY, how="inner")
        content = _parquet(part)
        self._folder.write(f"{PARTS}/{sha256(content)}.parquet", content)

    @contextmanager
    def parts(
        self, started: float, rows: Sequence[Row] = (), matrix: pl.DataFrame | None = None
    ) -> Iterator[Callable[[Row], None]]:
        """Take rows and append them from time to time, and when the block ends, however it ends.

        ``started`` is the start by ``time.monotonic``; ``rows`` were flown since.
        """
        waiting, written = list(rows), started

        def take(row: Row) -> None:
            nonlocal written
            waiting.append(row)
            now = time.monotonic()
            pause = min(max(_PART_SHARE * (now - started), _PART_S[0]), _PART_S[1])
            if now - written >= pause or len(waiting) >= _PART_ROWS:
                self.append(waiting, matrix)
                waiting.clear()
                written = now

        try:
            yield take
        finally:
            if waiting:
                self.append(waiting, matrix)

    def finish(self, matrix: pl.DataFrame) -> None:
        """Make the table from the parts and remove these. ``matrix`` has one row per mission.

        Raises UserError where parts were removed meanwhile.
        """
        parts = self._folder.names(PARTS)
        table = matrix.join(self.outcomes(list(_SCHEMA)), on=KEY, how="inner", maintain_order="left")
        if len(table) < len(matrix):
            raise UserError(
                f"{self._folder}: {len(matrix) - len(table)} missions were removed while the sweep ran; "
                "give the same command again"
            )
        timings, metrics = table.select("job", *KEY, *TIMINGS), table.drop(*TIMINGS)
        self._replace({TIMINGS_FILE: _parquet(timings), TABLE_FILE: _parquet(metrics)})
        if self._folder.names(PARTS) == parts:  # else another process flies into the folder
            self._folder.remove(PARTS)

    def finish_all(self) -> None:
        """Make the table of a comparison from all that parts and table hold."""
        held = numbered(self.outcomes())
        self.finish(held.select("job", *MATRIX_COLUMNS, *_parameters(held), "config_hash"))

    def outcomes(self, columns: list[str] | None = None) -> pl.DataFrame:
        """These columns, or all but ``job``, of each finished mission, from the parts and the table.

        Of a mission that failed and was flown again, the row without an error counts.
        """
        frames = [self._part(name) for name in self._folder.names(PARTS)]
        if self.has_table():
            frames.append(self._timed(self.table()))
        if columns is not None:  # an older skysweep counted less
            frames = [frame.select(name for name in columns if name in frame.columns) for frame in frames]
        empty = pl.DataFrame(schema={name: _SCHEMA[name] for name in columns or _SCHEMA})
        found = pl.concat([empty, *frames], how="diagonal_relaxed")
        failed_last = found.sort(pl.col("error").is_not_null(), maintain_order=True)
        return failed_last.unique(KEY, keep="first", maintain_order=True)

    def table(self, columns: list[str] | None = None) -> pl.DataFrame:
        """All columns of the table, or these."""
        return _frame(self._checked(TABLE_FILE) or b"", self._folder.where(TABLE_FILE), columns)

    def _timed(self, table: pl.DataFrame) -> pl.DataFrame:
        """The table with its timings, which may be of before it grew, or lost; without numbers."""
        content = self._checked(TIMINGS_FILE)
        if content is None:
            return table.drop("job")
        timings = _frame(content, self._folder.where(TIMINGS_FILE))
        by = ["job"] if "config_hash" not in timings.columns else list(KEY)  # an older skysweep: by number
        return table.join(timings.select(*by, *TIMINGS), on=by, how="left").drop("job")

    def _part(self, name: str) -> pl.DataFrame:
        content, where = self._folder.read(name) or b"", self._folder.where(name)
        checksums.refuse_misnamed(name, content, where)
        return _frame(content, where)

    def _checked(self, name: str) -> bytes | None:
        """The content of a file, if there is one. Raises UserError where it is damaged."""
        content = self._folder.read(name)
        if content is not None:
            checksums.refuse_changed(self._sums(), name, content, self._folder.where(name))
        return content

    def _sums(self) -> Sums | None:
        content = self._folder.read(SUMS_FILE)
        return None if content is None else checksums.read_sums(content, self._folder.where(SUMS_FILE))

    def _replace(self, contents: Mapping[str, bytes]) -> None:
        """Write files and their digests. A kill in between leaves a folder that is still valid."""
        sums = self._sums()
        if sums is None:
            found = {name: self._folder.read(name) for name in (SPEC_FILE, TABLE_FILE, TIMINGS_FILE)}
            sums = {name: frozenset([sha256(old)]) for name, old in found.items() if old is not None}
        new = {name: frozenset([sha256(content)]) for name, content in contents.items()}
        both = {name: sums.get(name, frozenset()) | digest for name, digest in new.items()}
        self._folder.write(SUMS_FILE, checksums.dump_sums({**sums, **both}))
        for name, content in contents.items():
            self._folder.write(name, content)
        self._folder.write(SUMS_FILE, checksums.dump_sums({**sums, **new}))


def _parameters(table: pl.DataFrame) -> list[str]:
    return sorted(name for name in table.columns if name.startswith("param."))


def _parquet(frame: pl.DataFrame) -> bytes:
    content = io.BytesIO()
    frame.write_parquet(content, compression="zstd", compression_level=3, row_group_size=100_000)
    return content.getvalue()


def _frame(content: bytes, where: str, columns: list[str] | None = None) -> pl.DataFrame:
    try:
        return pl.read_parquet(io.BytesIO(content), columns=columns)
    except (pl.exceptions.PolarsError, OSError):
        raise UserError(
            f"{where}: is missing, or not a Parquet table; delete it and give the command that flew it again"
        ) from None
