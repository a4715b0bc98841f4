"""The measures of every contender in every family, with 95 % intervals over the seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skysweep.experiments.benchmark.suite import SCAN_ONLY, Contender
from skysweep.results.reporting.statistics import Estimate, estimate, ratio_of_means
from skysweep.results.summary import Summary
from skysweep.types import F64


@dataclass(frozen=True, slots=True)
class Measure:
    """A number that is measured in every mission."""

    key: str
    title: str
    decimals: int
    of_bound: bool = False  # whether the oracle has it, which confirms nothing
    is_time: bool = False  # too short where a mission ended before its search


MEASURES = (
    Measure("mission_time_s", "Mission time (s)", 0, of_bound=True, is_time=True),
    Measure("above_scan_only_s", "Above scan-only (s)", 1, of_bound=True, is_time=True),
    Measure("recall", "Recall", 3),
    Measure("false_positives", "False positives", 2),
    Measure("false_positives_per_ha", "a hectare", 2),
    Measure("duplicates", "Duplicates among them", 2),
    Measure("half_found_s", "Half found (s)", 0, is_time=True),
    Measure("checks", "Checks", 1, of_bound=True),
    Measure("completed", "Completed", 2, of_bound=True),
)
OVERVIEW = (*MEASURES[:4], MEASURES[-1])
ABOVE = MEASURES[1]


@dataclass(frozen=True, slots=True)
class Standing:
    """A contender in a family: the mean of each measure, and of its difference from the reference's."""

    contender: Contender
    means: Mapping[str, Estimate]
    differences: Mapping[str, Estimate]
    of_oracle: Estimate | None  # its time above scan-only over the oracle's; None where neither has any

    @property
    def is_cut(self) -> bool:
        """Whether missions of it ended before their search, so that its times are too short."""
        return self.means["completed"].mean < 1.0

    def mean(self, key: str) -> Estimate | None:
        """Of a measure; None where it means nothing for the oracle."""
        return self.means.get(key)


def values_of(missions: Sequence[Summary], scan_only: Sequence[Summary]) -> dict[str, F64]:
    """The measures (n,) of missions; those of ``scan_only`` have the same seeds."""
    hectares = missions[0]["area_m2"] / 1e4
    columns = {
        "mission_time_s": [m["mission_time_s"] for m in missions],
        "recall": [m["recall"] for m in missions],
        "false_positives": [m["false_positives"] for m in missions],
        "duplicates": [m["duplicates"] for m in missions],
        "half_found_s": [half_found_s(m) for m in missions],
        "checks": [m["n_checks"] for m in missions],
        "completed": [m["completed"] for m in missions],
    }
    values = {key: np.array(column, dtype=float) for key, column in columns.items()}
    scanned_s = np.array([m["mission_time_s"] for m in scan_only])
    return values | {
        "above_scan_only_s": values["mission_time_s"] - scanned_s,
        "false_positives_per_ha": values["false_positives"] / hectares,
    }


def half_found_s(mission: Summary) -> float:
    """When half of the targets were confirmed; the end of the search where that many never were."""
    times_s = mission["time_to_confirm_s"] or []
    found_s = sorted(t for t in times_s if t is not None)
    needed = math.ceil(len(times_s) / 2)
    return found_s[needed - 1] if 0 < needed <= len(found_s) else mission["mission_time_s"]


def standings(
    flown: Mapping[str, Sequence[Summary]], contenders: Sequence[Contender], reference: str
) -> list[Standing]:
    """Every contender in one family, compared with ``reference`` seed by seed."""
    values = {c.name: values_of(flown[c.name], flown[SCAN_ONLY]) for c in contenders}
    oracle_s = next(values[c.name][ABOVE.key] for c in contenders if c.is_bound)
    found = []
    for contender in contenders:
        own = values[contender.name]
        measures = [m for m in MEASURES if m.of_bound or not contender.is_bound]
        of_oracle = None
        if not (contender.is_bound or contender.name == SCAN_ONLY) and oracle_s.mean() > 0:
            of_oracle = ratio_of_means(own[ABOVE.key], oracle_s)
        found.append(
            Standing(
                contender,
                {m.key: estimate(own[m.key]) for m in measures},
                {m.key: estimate(own[m.key] - values[reference][m.key]) for m in measures},
                of_oracle,
            )
        )
    return found
