"""Many missions, numbered: configurations and the seeds that each of them flies."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import polars as pl

from skysweep.detection.model_files import own_model_path, sha256_of
from skysweep.scenarios.model import OWN_DETECTORS, Scenario
from skysweep.sensing.statistical.model import own_sensor_path
from skysweep.strategies import code_of, strategy_spec
from skysweep.strategies.fields import value_at
from skysweep.worlds.ground_files import ground_digest

RESULTS_VERSION = 11  # increased when missions of the same scenario and seed end differently than before


@dataclass(frozen=True, slots=True)
class LabelledScenario:
    """A scenario that every seed flies."""

    label: str  # of its scenario
    scenario: Scenario
    digest: str  # of everything that decides how its missions end, but the seed


@dataclass(frozen=True, slots=True)
class MissionJob:
    """One mission of many."""

    label: str
    scenario: Scenario
    seed: int
    sensor: str
    config_hash: str  # of everything that decides how it ends


@dataclass(frozen=True)
class Matrix:
    """Each configuration with each seed. All configurations fly a seed before the next seed begins."""

    configurations: tuple[LabelledScenario, ...]
    seeds: Sequence[int]
    sensor: str
    fields: tuple[str, ...]  # dotted names of the fields in which the configurations differ

    @classmethod
    def of(
        cls,
        scenarios: Iterable[tuple[str, Scenario]],
        seeds: Sequence[int],
        sensor: str,
        fields: Iterable[str],
        results_version: int = RESULTS_VERSION,
    ) -> Matrix:
        """The missions of ``scenarios`` (label and scenario), without duplicates."""
        configurations = {
            (label, digest): LabelledScenario(label, scenario, digest)
            for label, scenario in scenarios
            for digest in [digest_of(scenario, sensor, results_version)]
        }
        return cls(tuple(configurations.values()), seeds, sensor, tuple(fields))

    def __len__(self) -> int:
        return len(self.configurations) * len(self.seeds)

    def job(self, number: int) -> MissionJob:
        turn, place = divmod(number, len(self.configurations))
        c, seed = self.configurations[place], self.seeds[turn]
        return MissionJob(c.label, c.scenario, seed, self.sensor, _config_hash(c.digest, seed))

    def jobs(self, numbers: Iterable[int] | None = None) -> Iterator[MissionJob]:
        return (self.job(number) for number in (range(len(self)) if numbers is None else numbers))

    def table(self) -> pl.DataFrame:
        """One row per mission: job, scenario, strategy, seed, sensor, param.<field> ..., config_hash."""
        cells = pl.DataFrame(
            {
                "scenario": [c.label for c in self.configurations],
                "strategy": [c.scenario.search.strategy for c in self.configurations],
                "digest": [c.digest for c in self.configurations],
            }
            | {f"param.{field}": self._values(field) for field in self.fields}
        )
        seeds = pl.DataFrame({"seed": list(self.seeds)}, schema={"seed": pl.Int64})
        table = seeds.join(cells, how="cross", maintain_order="left_right").with_row_index("job")
        hashes = [_config_hash(d, s) for d, s in zip(table["digest"], table["seed"], strict=True)]
        return table.select(
            pl.col("job").cast(pl.Int64),
            "scenario",
            "strategy",
            "seed",
            pl.lit(self.sensor).alias("sensor"),
            *[f"param.{field}" for field in self.fields],
            pl.Series("config_hash", hashes),
        )

    def _values(self, field: str) -> pl.Series:
        """The value of a field in each configuration. Numbers are floats; of several types all are words."""
        values = [value_at(c.scenario, field) for c in self.configurations]
        is_number = all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values)
        if not is_number and len({type(v) for v in values if v is not None}) > 1:
            values = [None if v is None else v if isinstance(v, str) else json.dumps(v) for v in values]
        return pl.Series(values, dtype=pl.Float64 if is_number else None)


def _config_hash(digest: str, seed: int) -> str:
    return hashlib.sha256(f"{digest}|{seed}".encode()).hexdigest()[:16]


def digest_of(scenario: Scenario, sensor: str, results_version: int) -> str:
    """A digest of the resolved scenario, the sensor, the files that missions read, and the version."""
    fields = scenario.model_dump(by_alias=True)
    if scenario.search.parameters:
        fields["search"]["parameters"] = strategy_spec(scenario.search.strategy).told_of(scenario.search)
    own, version = code_of(scenario.search.strategy)
    named = [scenario.search.plan, *scenario.detector.model_dump().values(), *map(str, own)]
    files = _shipped_files(scenario, sensor)
    files += [Path(n) for n in named if isinstance(n, str) and os.path.isfile(n)]
    ground = ground_digest(scenario)
    code = [*map(sha256_of, files), *([version] if version else []), *([ground] if ground else [])]
    text = json.dumps([fields, sensor, code, results_version], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _shipped_files(scenario: Scenario, sensor: str) -> list[Path]:
    """The shipped detector and sensor model that missions look or reckon with."""
    detector, files = scenario.detector, []
    if sensor == "imaging" and detector.model in OWN_DETECTORS.values():
        files.append(own_model_path(detector.model))
    reckons = sensor == "statistical" or strategy_spec(scenario.search.strategy).needs_sensor_model
    if reckons and detector.statistical_model is None:
        files.append(own_sensor_path(scenario.camera.kind))
    return files
