"""The suite: families of scenarios, seeds fixed by its version, and the strategies that are compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Annotated, Any, Literal

from pydantic import Field

from skysweep.errors import UserError
from skysweep.experiments.matrix import Matrix
from skysweep.files.models import validated
from skysweep.files.plain_yaml import parse_yaml
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.scenarios.model import Model, Scenario
from skysweep.strategies import strategy_spec

VERSION = "sar-1"
ORACLE = "oracle-bound"  # where other missions have the name of a strategy

_LIMITS = ("n_c", "d_c_m", "scan_altitude_agl_m", "check_altitude_agl_m", "confirm_height_max_m")
_FIELDS = tuple(f"search.{name}" for name in _LIMITS)

Changes = dict[str, Any]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=True)]


class Seeds(Model):
    """The seeds that are reported."""

    first: int
    count: int
    quick: int = Field(description="How many a quick run flies")

    def chosen(self, quick: bool) -> range:
        """All of them, or those of a quick run."""
        return range(self.first, self.first + (self.quick if quick else self.count))


class Family(Model):
    """Scenarios that differ by their seed."""

    label: str
    scenario: str
    changes: Changes = Field(alias="set")
    paper_n_c: Limit
    tuned: str = Field(description="Name of the parameters of Algorithm 1 that were tuned for it")

    def base(self) -> Scenario:
        """Its scenario, before a strategy is chosen."""
        return change_scenario(load_scenario(self.scenario), self.changes)


class BreakEven(Model):
    """Missions with ever more look-alikes, in which a false alarm has a price."""

    scenario: str
    changes: Changes = Field(alias="set")
    targets: Changes
    look_alikes: Changes
    counts: list[int]
    prices_s: list[float]
    missed_cost_s: float
    tuned: str
    seeds: Seeds


class Suite(Model):
    """A version of the benchmark."""

    version: str
    seeds: Seeds
    sensor: Literal["statistical"]
    target_px: float = Field(description="That the smallest target spans in a close look")
    tuned: dict[str, Changes]
    families: list[Family]
    break_even: BreakEven


@dataclass(frozen=True, slots=True)
class Contender:
    """A strategy with what it changes in each family's scenario."""

    name: str
    strategy: str
    what: str
    changes: Literal["none", "paper", "tuned", "close look"] = "none"

    @property
    def is_bound(self) -> bool:
        """Whether it is the oracle, which is no strategy."""
        return self.strategy == ORACLE


SCAN_ONLY, TUNED = "scan-only", "algorithm-1-tuned"
OURS = (
    Contender(SCAN_ONLY, "scan-only", "flies the transects once and never descends"),
    Contender("low-only", "low-only", "flies them once at the check altitude"),
    Contender("algorithm-1", "scan-check", "Algorithm 1 with the paper's n_c, d_c infinite", "paper"),
    Contender(TUNED, "scan-check", "Algorithm 1 as tuned for the family", "tuned"),
    Contender("belief", "belief", "the belief strategy with its defaults"),
    Contender("belief-close", "belief", "belief, where a close look is demanded", "close look"),
    Contender("oracle", ORACLE, "no strategy: the bound of those that look closely at every target"),
)


def load_suite() -> Suite:
    """The suite ``sar-1``."""
    name = f"{VERSION}.yaml"
    text = (resources.files("skysweep.experiments.benchmark") / name).read_text(encoding="utf-8")
    return validated(Suite, parse_yaml(text, name), name)


def contenders(added: Sequence[str] = (), among: Sequence[Contender] = OURS) -> tuple[Contender, ...]:
    """Ours, and the ``added`` strategies, before the oracle.

    Raises UserError where there is no such strategy, or it is one of ours.
    """
    *ours, oracle = among
    for name in dict.fromkeys(added):
        if name in {c.name for c in among}:
            raise UserError(f"--strategy {name}: is in the benchmark already; leave it out")
        try:
            strategy_spec(name)
        except UserError as error:
            raise UserError(f"--strategy: {str(error).removeprefix('search.strategy: ')}") from None
        ours.append(Contender(name, name, "added"))
    return (*ours, oracle)


def close_look_m(scenario: Scenario, target_px: float) -> float:
    """The height from which the smallest target's size spans ``target_px``, at most that of the scan."""
    smallest_m = min(low for low, _ in scenario.target_sizes_m.values())
    height_m = scenario.camera.lens.focal_px * smallest_m / target_px
    return round(min(height_m, scenario.search.scan_altitude_agl_m), 2)


def scenario_for(suite: Suite, family: Family, contender: Contender) -> Scenario:
    """What a contender flies in a family."""
    base = family.base()
    changes: Mapping[str, Changes] = {
        "none": {},
        "paper": {"search.n_c": family.paper_n_c, "search.d_c_m": float("inf")},
        "tuned": suite.tuned[family.tuned],
        "close look": {"search.confirm_height_max_m": close_look_m(base, suite.target_px)},
    }
    return change_scenario(base, {"search.strategy": contender.strategy, **changes[contender.changes]})


def suite_matrices(suite: Suite, chosen: Sequence[Contender], seeds: Sequence[int]) -> dict[str, Matrix]:
    """The missions of all families by contender."""
    return {
        c.name: Matrix.of(
            ((f.label, scenario_for(suite, f, c)) for f in suite.families), seeds, suite.sensor, _FIELDS
        )
        for c in chosen
    }


def look_alike_scenarios(suite: Suite) -> Iterator[tuple[int, Scenario]]:
    """The scenarios of the break-even by their number of look-alikes."""
    spec = suite.break_even
    base = change_scenario(load_scenario(spec.scenario), spec.changes)
    for count in spec.counts:
        generators = [spec.targets, *([{**spec.look_alikes, "count": count}] if count else [])]
        yield count, change_scenario(base, {"generators": generators})
