"""Flies thousands of missions into one table, on any engine, in any number of runs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import polars as pl
import yaml

from skysweep.errors import UserError
from skysweep.experiments.engines import Engine
from skysweep.experiments.matrix import MissionJob
from skysweep.experiments.store import KEY, MissionStore, Row, row_of
from skysweep.experiments.sweep.spec import SweepSpec, differences, dump_spec, matrix_of
from skysweep.files.folder import Folder
from skysweep.flights.build import refuse_unseeable
from skysweep.flights.fly import fly_in_memory
from skysweep.results.run_folder import SPEC_FILE, TABLE_FILE

_FIRST = 16  # least number of missions behind the estimate, from as many configurations
_FIRST_S = 20.0  # after this time the estimate waits for no more of them than needed
_MAX_ERROR = 500  # characters
_MAX_DIFFERENCES = 3


@dataclass(frozen=True, slots=True)
class Outlook:
    """The estimated duration of a sweep, from its first missions."""

    missions: int  # that are left
    workers: int
    mission_s: float  # one mission on one worker

    @property
    def seconds(self) -> float:
        return self.missions * self.mission_s / self.workers


class Sweep:
    """A spec and the folder of its missions, a path or an fsspec URL.

    With ``retry_failed``, failed missions are flown again. Raises UserError where the folder holds other
    missions.
    """

    def __init__(self, spec: SweepSpec, out: str | os.PathLike[str], retry_failed: bool = False) -> None:
        self._spec, self._folder = spec, Folder(out)
        self._store = MissionStore(self._folder)
        self._matrix = matrix_of(spec)
        self._table = self._matrix.table()
        known = self._known()
        if retry_failed:
            known = known.filter(pl.col("error").is_null())
        self._todo: list[int] = self._table.join(known, on=KEY, how="anti")["job"].to_list()

    @property
    def configurations(self) -> int:
        """The number of different missions that fly with each seed."""
        return len(self._matrix.configurations)

    @property
    def missions(self) -> int:
        return len(self._matrix)

    @property
    def left(self) -> int:
        return len(self._todo)

    @property
    def address(self) -> str:
        return self._folder.where(TABLE_FILE)

    def fly(
        self,
        engine: Engine,
        confirm: Callable[[Outlook], None] = lambda _outlook: None,
        on_done: Callable[[str | None], None] = lambda _error: None,
    ) -> None:
        """Fly what is left and make the table.

        ``confirm`` is called with the estimate after the first missions; its exception ends the sweep.
        ``on_done`` is called with the error, or None, of each mission. After an interruption another
        ``Sweep`` with the same folder continues. Raises UserError, and flies nothing, where a configuration's
        sensor does not fit its detector or camera, the folder cannot be written to, or another process flies
        into it or has changed what it holds.
        """
        if self._todo:
            for configuration in self._matrix.configurations:
                refuse_unseeable(configuration.scenario, self._matrix.sensor)
            self._folder.try_out()
            with self._folder.locked(), engine:
                self._known()
                self._fly(engine, confirm, on_done)
                self._finish()
        else:
            self._finish()
        self._todo = []

    def _finish(self) -> None:
        text = dump_spec(self._spec)
        if self._todo or self._store.spec() != text or not self._store.is_complete():
            self._store.write_spec(text)
            self._store.finish(self._table)

    def errors(self) -> list[str]:
        known = self._store.known().join(self._table, on=KEY, how="semi")
        return known["error"].drop_nulls().to_list()

    def _fly(
        self, engine: Engine, confirm: Callable[[Outlook], None], on_done: Callable[[str | None], None]
    ) -> None:
        started = time.monotonic()
        count = max(_FIRST, 2 * engine.workers)
        first = _spread(self._todo[: max(self.configurations, count)], count)
        rest = sorted(set(self._todo).difference(first))
        rows: list[Row] = []
        with closing(engine.run(fly_job, self._matrix.jobs([*first, *rest]))) as results:
            try:
                for _, row in results:
                    rows.append(row)
                    on_done(row["error"])
                    late = time.monotonic() - started > _FIRST_S
                    if len(rows) == len(first) or (late and len(rows) > engine.workers):
                        break
            except BaseException:
                if rows:
                    self._store.write_spec(dump_spec(self._spec))
                    self._store.append(rows)
                raise
            if left := len(self._todo) - len(rows):
                confirm(Outlook(left, min(engine.workers, left), _mission_s(rows, engine.workers)))
            self._store.write_spec(dump_spec(self._spec))
            with self._store.parts(started, rows) as take:
                for _, row in results:
                    take(row)
                    on_done(row["error"])

    def _known(self) -> pl.DataFrame:
        """The missions already in the folder. Raises UserError where they are not of this sweep."""
        self._store.refuse_run()
        stored = self._store.spec()
        if stored is None and self._store.has_table():
            raise UserError(f"{self._folder}: holds a {TABLE_FILE} and no {SPEC_FILE}; write another --out")
        known = self._store.known()
        if known.join(self._table, on=KEY, how="anti").is_empty():
            return known
        ours = yaml.safe_load(dump_spec(self._spec))
        what = list(differences(yaml.safe_load(stored or ""), ours))[:_MAX_DIFFERENCES] or [
            "the file of the detector, the sensor, the plan or the strategy differs"
        ]
        raise UserError(
            f"{self._folder}: holds the results of another sweep ({'; '.join(what)}); write another --out"
        )


def fly_job(job: MissionJob) -> Row:
    """The row of one mission, with its error where it failed."""
    try:
        return row_of(job.label, job.config_hash, fly_in_memory(job.scenario, job.seed, job.sensor))
    except Exception as error:
        reason = " ".join(str(error).split())[:_MAX_ERROR]
        kind = "" if isinstance(error, UserError) else f"{type(error).__name__}: "
        return row_of(job.label, job.config_hash, None, kind + reason)


def _spread(numbers: list[int], count: int) -> list[int]:
    return numbers[:: -(-len(numbers) // count)]


def _mission_s(rows: list[Row], workers: int) -> float:
    """Mean time of a mission, where possible without each worker's first, which also loads the program."""
    times = [row["wall_time_s"] for row in rows if row["wall_time_s"] is not None]
    if len(times) > workers:
        times = times[workers:]
    return sum(times) / len(times) if times else 0.0
