"""The missions of a sweep or of a comparison with the paper, by scenario and configuration."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl
from numpy.typing import NDArray

from skysweep.errors import UserError
from skysweep.experiments.store import KEY, OLDER_FILE, MissionStore, numbered
from skysweep.files.folder import Folder
from skysweep.results.reporting.symbols import field_name, value_text
from skysweep.results.run_folder import TABLE_FILE
from skysweep.types import F64

Value = float | str | bool

PARAMETER = "param."
_NEEDED = ("scenario", "strategy", "seed", "completed", "mission_time_s", "recall", "false_positives")
_WRITERS = "give a folder that 'skysweep run', 'skysweep sweep' or 'skysweep compare paper' wrote"


@dataclass(frozen=True, slots=True)
class Metric:
    """A number of summary.json for comparing configurations."""

    key: str
    name: str
    unit: str
    decimals: int
    more_is_better: bool = False

    @property
    def title(self) -> str:
        return f"{self.name} ({self.unit})" if self.unit else self.name


MISSION_TIME = Metric("mission_time_s", "Mission time", "s", 1)
RECALL = Metric("recall", "Recall", "", 3, more_is_better=True)
FALSE_SCANS = Metric("false_scans", "False scans", "", 2)
FALSE_POSITIVES = Metric("false_positives", "False positives", "", 2)
ENERGY = Metric("energy_wh", "Energy", "Wh", 1)
COMPARED = (MISSION_TIME, RECALL, FALSE_SCANS, FALSE_POSITIVES, ENERGY)
METRICS = (
    *COMPARED,
    Metric("total_time_s", "Total time", "s", 1),
    Metric("n_checks", "Descents", "", 2),
    Metric("path_length_m", "Path", "m", 0),
    Metric("median_localisation_error_m", "Localisation error", "m", 2),
)


@dataclass(frozen=True, slots=True)
class Missions:
    """A table of missions, one row each, and its source."""

    source: str
    table: pl.DataFrame
    finished: bool  # false for a sweep that still runs or was stopped
    spec: str = ""  # text of the sweep's specification

    @property
    def parameters(self) -> tuple[str, ...]:
        """Swept fields of the scenario, such as ``search.n_c``."""
        columns = self.table.columns
        return tuple(name.removeprefix(PARAMETER) for name in columns if name.startswith(PARAMETER))

    @property
    def failed(self) -> pl.DataFrame:
        return self.table.filter(pl.col("error").is_not_null())


@dataclass(frozen=True, slots=True)
class Configuration:
    """A strategy and the values of the swept fields."""

    strategy: str
    parameters: tuple[tuple[str, Value], ...]

    def only(self, fields: Collection[str]) -> Configuration:
        return Configuration(self.strategy, tuple(p for p in self.parameters if p[0] in fields))

    def without(self, field: str) -> Configuration:
        return Configuration(self.strategy, tuple(p for p in self.parameters if p[0] != field))

    def label(self, with_strategy: bool) -> str:
        """Such as ``scan-check, n_c = 5, d_c = 60 m``."""
        parts = [f"{field_name(field)} = {value_text(field, value)}" for field, value in self.parameters]
        return ", ".join([self.strategy, *parts] if with_strategy or not parts else parts)


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """The missions of one configuration in one scenario. Arrays are of those without an error, by seed."""

    configuration: Configuration
    label: str
    seeds: NDArray[np.int64]  # (n,)
    values: dict[str, F64]  # metric -> (n,); NaN: does not apply
    pos: tuple[F64, ...]  # n curves, steps (K, 2) of time s and share confirmed
    n_failed: int
    n_unfinished: int  # ended before the search was finished

    @property
    def n(self) -> int:
        return len(self.seeds)


def load_missions(folder: str, matrix: Callable[[str], pl.DataFrame] | None = None) -> Missions:
    """The missions in a folder or fsspec URL: of a sweep, finished or not, or of a comparison.

    ``matrix`` turns the text of a specification into a table of its missions (job, scenario, strategy, seed,
    sensor, parameters, config_hash). Parts of a running sweep have only scenario and config_hash of these.
    Raises UserError where the folder is missing, unreadable, damaged, or has no mission without an error.
    """
    kept = Folder(folder)
    store = MissionStore(kept)
    try:
        if not kept.exists():
            raise UserError(f"{folder}: there is no such folder; {_WRITERS}")
        if kept.exists(OLDER_FILE):
            raise UserError(
                f"{folder}: holds the missions of an older skysweep ({OLDER_FILE}), which this one does not "
                "read; report them with that one, or fly them again into another folder"
            )
        spec = store.spec()
        finished = not store.has_parts()
        if not finished and spec is not None and matrix is not None:
            table = _so_far(matrix(spec), store.outcomes(), folder)
        elif not finished:
            table = numbered(store.outcomes())
        elif store.has_table():
            table = store.table()
        else:
            raise UserError(f"{folder}: holds no missions ({TABLE_FILE}); {_WRITERS}")
    except UserError:
        raise
    except Exception as error:  # each file system has its own
        reason = " ".join(str(error).split()) or type(error).__name__
        raise UserError(f"{folder}: cannot be read ({reason}); {_WRITERS}") from None
    return Missions(folder, _checked(table, folder), finished, spec or "")


def _so_far(jobs: pl.DataFrame, flown: pl.DataFrame, folder: str) -> pl.DataFrame:
    """The flown ones of the missions in the specification."""
    known = [name for name in jobs.columns if name not in KEY]
    table = jobs.join(flown.drop(known, strict=False), on=KEY, how="inner")
    if not len(table):
        raise UserError(
            f"{folder}: the sweep is not finished, and its missions so far are of another version of "
            "skysweep or of the specification; give the sweep again"
        )
    return table


def _checked(table: pl.DataFrame, folder: str) -> pl.DataFrame:
    """The rows in order, without duplicates. Raises UserError where the table makes no sense."""
    if "error" not in table.columns:
        table = table.with_columns(error=pl.lit(None, dtype=pl.String))
    if "job" in table.columns:
        table = table.unique("job", keep="first").sort("job")
    failed = table.filter(pl.col("error").is_not_null())
    if not len(table):
        raise UserError(f"{folder}: the table of missions is empty; {_WRITERS}")
    if len(failed) == len(table):
        first = failed.row(0, named=True)
        raise UserError(
            f"{folder}: all {len(table)} missions failed, so there is nothing to report; the first "
            f"({first['scenario']}, {first['strategy']}, seed {first['seed']}) says: {first['error']}"
        )
    missing = [name for name in _NEEDED if name not in table.columns]
    if missing:
        raise UserError(f"{folder}: the table of missions has no column '{missing[0]}'; {_WRITERS}")
    key = ["scenario", "strategy", "seed", *(n for n in table.columns if n.startswith(PARAMETER))]
    if table.select(key).is_duplicated().any():
        row = table.filter(table.select(key).is_duplicated()).row(0, named=True)
        raise UserError(
            f"{folder}: {row['scenario']}, {row['strategy']}, seed {row['seed']} is in the table twice; give "
            "each scenario of a sweep a name of its own, and a comparison with other parameters another --out"
        )
    return table


def by_scenario(missions: Missions) -> dict[str, list[Flown]]:
    """Scenario -> its configurations, both in the order of the table."""
    table = missions.table
    columns = [PARAMETER + field for field in missions.parameters]
    several = table["strategy"].n_unique() > 1
    varied = {
        strategy: [field for field in missions.parameters if rows[PARAMETER + field].n_unique() > 1]
        for (strategy,), rows in table.group_by("strategy")
    }
    groups: dict[str, list[Flown]] = {}
    for key, rows in table.group_by("scenario", "strategy", *columns, maintain_order=True):
        scenario, strategy, *values = key
        chosen = tuple((f, v) for f, v in zip(missions.parameters, values, strict=True) if v is not None)
        configuration = Configuration(str(strategy), chosen)
        label = configuration.only(varied[strategy]).label(with_strategy=several)
        groups.setdefault(str(scenario), []).append(_flown(configuration, label, rows))
    return groups


def _flown(configuration: Configuration, label: str, rows: pl.DataFrame) -> Flown:
    good = rows.filter(pl.col("error").is_null()).sort("seed")
    curves = good.select("pos_time_s", "pos_value").iter_rows() if "pos_time_s" in good.columns else ()
    return Flown(
        configuration=configuration,
        label=label,
        seeds=good["seed"].to_numpy().astype(np.int64),
        values={
            metric.key: good[metric.key].cast(pl.Float64).fill_null(math.nan).to_numpy()
            for metric in METRICS
            if metric.key in good.columns
        },
        pos=tuple(np.column_stack(curve).astype(float) for curve in curves if curve[0]),
        n_failed=len(rows) - len(good),
        n_unfinished=int((~good["completed"].cast(pl.Boolean).fill_null(False)).sum()),
    )


def in_order(values: Sequence[Value]) -> list[Value]:
    """Distinct values, ascending, with infinity last; words alphabetically."""
    return sorted(set(values), key=lambda v: (isinstance(v, str), v))
