"""Many missions in one table, and their statistics."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeVar

import fsspec
import numpy as np
import polars as pl
import yaml
from numpy.typing import ArrayLike

from skysweep.api.parts import StrategyLike, strategy_of
from skysweep.api.progress import progress
from skysweep.api.scenarios import ScenarioLike, load_scenario
from skysweep.errors import UserError
from skysweep.experiments.engines import Engine, LocalEngine
from skysweep.experiments.sweep.run import Sweep
from skysweep.experiments.sweep.spec import parse_spec
from skysweep.files.plain_yaml import parse_yaml
from skysweep.results.reporting import statistics
from skysweep.results.reporting.statistics import Estimate, PairedTest
from skysweep.scenarios.files import dump_scenario
from skysweep.scenarios.model import Scenario
from skysweep.strategies.given import leads_back

Job = TypeVar("Job")
Result = TypeVar("Result")

_WORLD = ("scenario", "seed")
_CELL = (*_WORLD, "strategy")  # and the parameters: two missions of a pair share them


def sweep(
    scenarios: ScenarioLike | Sequence[ScenarioLike],
    strategies: StrategyLike | Sequence[StrategyLike] | None = None,
    seeds: int | Sequence[int] = 20,
    parameters: Mapping[str, Sequence[Any]] | None = None,
    sensor: Literal["statistical", "imaging"] = "statistical",
    out: str | Path | None = None,
    *,
    workers: int = 1,
    show_progress: bool = True,
) -> pl.DataFrame:
    """Fly every scenario with every strategy, combination of parameters and seed; a row a mission.

    Columns are scenario, strategy, seed, sensor, param.FIELD of each parameter, and the numbers of
    summary.json (docs/results.md) that docs/sweeps.md lists. ``error`` says why a mission failed; its numbers
    are null. The frame is polars'; ``.to_pandas()`` converts it if pandas and pyarrow are installed.

    Args:
        scenarios: one or several, each a name, a path or a ``Scenario``.
        strategies: names, "module:Name", or classes at the top of a module; by default the scenario's own.
        seeds: how many, or which.
        parameters: dotted fields and their values, such as ``{"search.n_c": [1, 5]}``.
        sensor: as in ``run``.
        out: a folder or fsspec URL that keeps the missions; a later call continues there. By default nothing
            is written.
        workers: processes. With 1 the missions fly in this one; with more, a script needs the usual
            ``if __name__ == "__main__":``.
        show_progress: in a notebook, or on standard error if it is a terminal.

    Raises:
        UserError: an argument is invalid, or every mission failed.
    """
    if not isinstance(workers, int) or workers < 1:
        raise UserError(f"workers: is {workers!r:.60}; write how many processes, 1 or more")
    if out is not None and not (isinstance(out, str | os.PathLike) and os.fspath(out)):
        raise UserError(f"out: is {out!r:.60}; write a folder or a URL, or leave it out")
    lasting = workers > 1 or out is not None
    names = None if strategies is None else [_name_of(s, lasting) for s in _several(strategies)]
    chosen = [load_scenario(s) for s in _several(scenarios)]
    _refuse_namesakes(chosen)
    spec = parse_spec(
        yaml.safe_dump(
            {
                "name": "sweep",
                "scenarios": [{"scenario": parse_yaml(dump_scenario(s), s.name)} for s in chosen],
                **({} if names is None else {"strategies": names}),
                "parameters": {field: _plain(values) for field, values in (parameters or {}).items()},
                "seeds": _plain(seeds),
                "sensor": sensor,
            }
        ),
        "sweep",
        Path.cwd(),
    )
    engine: Engine = InThisProcess() if workers == 1 else LocalEngine(workers)
    place = os.fspath(out) if out is not None else f"memory://{uuid.uuid4().hex}"
    try:
        flight = Sweep(spec, place)
        done = flight.missions - flight.left
        with progress(show_progress) as show:

            def on_done(_error: str | None) -> None:
                nonlocal done
                done += 1
                show(done / flight.missions, f"{done} of {flight.missions} missions")

            flight.fly(engine, on_done=on_done)
        errors = flight.errors()
        if len(errors) == flight.missions:
            raise UserError(f"every mission failed: {errors[0]}")
        with fsspec.open(flight.address, "rb") as table:
            return pl.read_parquet(table.read())
    finally:
        if out is None:
            files, root = fsspec.core.url_to_fs(place)
            if files.exists(root):
                files.rm(root, recursive=True)


def estimate(values: ArrayLike | pl.Series) -> Estimate:
    """Mean of values (N,) with its 95 % bootstrap interval (BCa), median and standard deviation.

    Nulls and NaN are ignored. Raises UserError if the values are no numbers.
    """
    try:
        return statistics.estimate(np.asarray(values, dtype=float).ravel())
    except (TypeError, ValueError):
        raise UserError("values: are no numbers; give a column such as missions['recall']") from None


def compare(missions: pl.DataFrame, metric: str, first: str, second: str, by: str = "strategy") -> PairedTest:
    """How much larger ``metric`` is in missions with ``first`` in the column ``by`` than with ``second``.

    Missions are paired by scenario, strategy, seed and all parameters, except for ``by``; pairs with a
    missing number are ignored. Only the seeds of a scenario are independent: its pairs with the same seed
    count as one, by the mean of their differences. ``n_pairs`` is the number of these. The mean difference
    has a 95 % bootstrap interval (BCa), p is Wilcoxon's. Raises UserError if there is no such column or
    value, or pairs are ambiguous or missing.
    """
    if not isinstance(missions, pl.DataFrame):
        raise UserError(f"missions: is a {type(missions).__name__}; give the table that sweep returns")
    for column in (metric, by, "seed"):
        if column not in missions.columns:
            raise UserError(f"{column}: is no column; write one of {', '.join(missions.columns)}")
    if not missions[metric].dtype.is_numeric() or missions[metric].cast(float).is_infinite().any():
        raise UserError(f"{metric}: is no number, or infinite; compare one such as mission_time_s")
    pairs = _pairs(missions, metric, first, second, by)
    worlds = [column for column in _WORLD if column in pairs.columns]
    difference = (pl.col("a") - pl.col("b")).mean()
    means = pairs.group_by(worlds, maintain_order=True).agg(difference=difference)["difference"].to_numpy()
    noise = 1e-12 * float(np.abs(pairs.select("a", "b").to_numpy()).max())
    return statistics.paired_tests(np.where(np.abs(means) > noise, means, 0.0)[:, None])[0]


def _pairs(missions: pl.DataFrame, metric: str, first: str, second: str, by: str) -> pl.DataFrame:
    """The pairs of missions that ``compare`` means, with both numbers, ``a`` and ``b``."""
    cell = [c for c in missions.columns if c != by and (c in _CELL or c.startswith("param."))]
    sides = []
    for value, side in ((first, "a"), (second, "b")):
        found = missions.filter([held == value for held in missions[by]])
        if found.is_empty():
            known = ", ".join(str(v) for v in missions[by].unique(maintain_order=True))
            raise UserError(f"{value}: no mission has this {by}; write one of {known}")
        if found.select(cell).is_duplicated().any():
            raise UserError(f"{value}: several missions have the same seed; keep one of each in the table")
        sides.append(found.select(*cell, pl.col(metric).cast(float).fill_nan(None).alias(side)))
    pairs = sides[0].join(sides[1], on=cell, how="inner", nulls_equal=True, maintain_order="left")
    pairs = pairs.drop_nulls(["a", "b"])
    if pairs.is_empty():
        raise UserError(f"{metric}: no mission with {first} has a partner with {second}")
    return pairs


class InThisProcess:
    """Flies the missions one after the other in this process. Implements ``Engine``."""

    workers = 1

    def __enter__(self) -> InThisProcess:
        """Nothing is held open."""
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing is held open."""

    def run(
        self, work: Callable[[Job], Result], jobs: Iterable[Job]
    ) -> Generator[tuple[Job, Result], None, None]:
        """See ``Engine.run``."""
        for job in jobs:
            yield job, work(job)


def _name_of(strategy: StrategyLike, lasting: bool) -> str:
    name, _ = strategy_of(strategy)
    if not isinstance(strategy, str) and not leads_back(strategy, lasting):
        raise UserError(
            f"strategies: {name} cannot be found by its name, as workers and kept results need; define it at "
            "the top of a module, or fly in this process, without workers and out"
        )
    return name


def _refuse_namesakes(scenarios: Sequence[Scenario]) -> None:
    names = [scenario.name for scenario in scenarios]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UserError(
            f"scenarios: two are called '{twice}'; change_scenario(scenario, {{'name': ...}}) renames one"
        )


def _several(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]


def _plain(values: Any) -> Any:
    """As plain data for YAML."""
    if isinstance(values, np.ndarray | np.generic):
        return values.tolist()
    return [_plain(v) for v in values] if isinstance(values, list | tuple | range) else values
