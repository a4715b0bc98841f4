"""The specification of a sweep: a YAML file of scenarios, strategies, parameters and seeds."""

from __future__ import annotations

import difflib
import itertools
import math
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import Field, ValidationInfo, field_validator, model_validator

from skysweep.errors import UserError
from skysweep.experiments.matrix import RESULTS_VERSION, Matrix
from skysweep.files.models import leaf_fields, validated
from skysweep.files.plain_yaml import MAX_YAML_BYTES, dump_yaml, parse_fields, parse_yaml
from skysweep.files.reading import read_text_limited
from skysweep.scenarios.files import (
    change_scenario,
    dump_scenario,
    list_scenarios,
    load_scenario,
    value_beside,
    with_nulls,
    with_paths_beside,
)
from skysweep.scenarios.model import Model, Scenario
from skysweep.strategies import strategy_spec
from skysweep.strategies.fields import OWN, checked

MAX_MISSIONS = 1_000_000
MAX_SEED = 2**32 - 1

Value = bool | int | Annotated[float, Field(allow_inf_nan=True)] | str
Parameters = dict[str, Annotated[list[Value], Field(min_length=1)]]
Part = TypeVar("Part", "SweepSpec", "StrategyChoice")
Points = list[Annotated[dict[str, Value], Field(min_length=1)]]

_WRITE = {
    "scenarios": "a name, or fields such as  scenario: ...",
    "strategies": "a name, or fields such as  strategy: ...",
    "parameters": "a number, .inf, a word, true or false, all in one list",
    "points": "a number, .inf, a word, true or false",
    "seeds": "how many, or a list of whole numbers",
}
_LABEL = r"^[A-Za-z0-9][A-Za-z0-9 ._-]*$"
_OWN_PLACE = {"search.strategy": "strategies", "name": "a scenario's label"}


class Variant(Model):
    """One scenario of a sweep: a shipped one, a file or its fields, with changes."""

    scenario: str | dict[str, Any] = Field(
        description="Name of a shipped scenario, path of a YAML file (from the spec's folder), or its fields"
    )
    label: str | None = Field(None, pattern=_LABEL, description="Added to its name in the results")
    changes: dict[str, Any] = Field(
        default_factory=dict, alias="set", description="Dotted fields of the scenario and their values"
    )


class StrategyChoice(Model):
    """One strategy of a sweep, with its own parameters where the sweep's do not apply."""

    strategy: str
    parameters: Parameters | None = Field(None, description="Instead of the sweep's parameters and points")
    points: Points | None = Field(None, description="Instead of the sweep's parameters and points")

    @field_validator("strategy")
    @classmethod
    def _exists(cls, name: str) -> str:
        try:
            strategy_spec(name)
        except UserError as error:
            raise ValueError(str(error).removeprefix("search.strategy: ")) from None
        return name


class SweepSpec(Model):
    """Scenarios x strategies x (every combination of parameters, and single points) x seeds."""

    name: str = Field(min_length=1, max_length=80, pattern=_LABEL)
    description: str = ""
    scenarios: list[Variant] = Field(min_length=1)
    strategies: list[StrategyChoice] | None = Field(
        None, min_length=1, description="Default: each scenario's own"
    )
    parameters: Parameters = Field(default_factory=dict, description="Dotted fields and their values")
    points: Points = Field(default_factory=list, description="Further combinations, written out one by one")
    seeds: int | list[int] = Field(description="How many, or which")
    first_seed: int = Field(0, ge=0, le=MAX_SEED, description="Where seeds is a number")
    sensor: Literal["statistical", "imaging"] = "statistical"
    results_version: int = Field(RESULTS_VERSION, description="Written by the sweep")

    @field_validator("scenarios", "strategies", mode="before")
    @classmethod
    def _spelt_out(cls, entries: Any, info: ValidationInfo) -> Any:
        """A bare name stands for an entry with that name."""
        if not isinstance(entries, list):
            return entries
        field = {"scenarios": "scenario", "strategies": "strategy"}[str(info.field_name)]
        return [{field: entry} if isinstance(entry, str) else entry for entry in entries]

    @field_validator("seeds", mode="before")
    @classmethod
    def _no_truth(cls, seeds: Any) -> Any:
        if isinstance(seeds, bool):
            raise ValueError(f"is {str(seeds).lower()}; write how many, or a list of whole numbers")
        return seeds

    @field_validator("seeds")
    @classmethod
    def _some_and_once(cls, seeds: int | list[int]) -> int | list[int]:
        if seeds == [] or (isinstance(seeds, int) and seeds < 1):
            raise ValueError(f"is {seeds}, so there is nothing to fly; write how many, or a list of seeds")
        if isinstance(seeds, int) and seeds > MAX_MISSIONS:
            raise ValueError(f"is more than one sweep can hold; write at most {MAX_MISSIONS:,}")
        if isinstance(seeds, list):
            if len(set(seeds)) < len(seeds):
                raise ValueError("a seed is written twice; keep one")
            if min(seeds) < 0 or max(seeds) > MAX_SEED:
                raise ValueError(f"a seed is out of range; write numbers from 0 to {MAX_SEED}")
        return seeds

    @model_validator(mode="after")
    def _can_be_flown(self) -> SweepSpec:
        if isinstance(self.seeds, list) and self.first_seed:
            raise ValueError("first_seed: seeds is a list, which says where it starts; leave first_seed out")
        for field in swept_fields(self):
            _check_field(field)
        per_scenario = sum(_count(parameters, points) for _, parameters, points in _per_strategy(self))
        configurations = len(self.scenarios) * per_scenario
        missions = configurations * len(seeds_of(self))
        if missions > MAX_MISSIONS:
            raise ValueError(
                f"makes {missions:,} missions ({configurations:,} configurations x {len(seeds_of(self)):,} "
                f"seeds), more than one sweep can hold ({MAX_MISSIONS:,}); write fewer values or seeds"
            )
        return self


def load_spec(path: str | Path) -> SweepSpec:
    """The sweep in a file. Raises UserError where there is none, and as ``parse_spec``."""
    path = Path(os.path.expanduser(path))
    text = read_text_limited(path, MAX_YAML_BYTES)
    return parse_spec(text, str(path), path.parent.absolute())


def parse_spec(text: str, source: str, folder: Path = Path()) -> SweepSpec:
    """The sweep in YAML text, with each scenario in full. ``source`` names it in errors.

    Relative paths start at ``folder``, and are resolved in what is returned if ``folder`` is absolute.
    Raises UserError where the text is not YAML, or not a sweep that can be flown.
    """
    fields = parse_fields(text, source, "sweep", "name, scenarios, parameters, seeds")
    spec = validated(SweepSpec, fields, source, _WRITE)
    try:
        spec = _with_values_beside(spec.model_copy(update={"scenarios": _written_out(spec, folder)}), folder)
        deque(scenarios_of(spec), maxlen=0)  # every combination can be flown
        return spec
    except UserError as error:
        raise UserError(f"{source}: {error}") from None


def dump_spec(spec: SweepSpec) -> str:
    """The sweep as YAML, for ``parse_spec``."""
    return dump_yaml(spec.model_dump(by_alias=True, exclude_none=True))


def seeds_of(spec: SweepSpec) -> tuple[int, ...] | range:
    """Every seed, in order."""
    if isinstance(spec.seeds, int):
        return range(spec.first_seed, spec.first_seed + spec.seeds)
    return tuple(spec.seeds)


def swept_fields(spec: SweepSpec) -> list[str]:
    """Dotted fields that the sweep varies, in the order of the file."""
    fields = [
        field
        for _, parameters, points in [("", spec.parameters, spec.points), *_per_strategy(spec)]
        for field in [*parameters, *itertools.chain.from_iterable(points)]
    ]
    return list(dict.fromkeys(fields))


def scenarios_of(spec: SweepSpec) -> Iterator[tuple[str, Scenario]]:
    """Each label and scenario, once per strategy and combination of parameters.

    Raises UserError where a combination makes no valid scenario, or a strategy has no such parameters.
    """
    for variant in spec.scenarios:
        base = _scenario(variant, Path())
        for strategy, parameters, points in _per_strategy(spec):
            chosen = {"search.strategy": strategy}
            for values in _combinations(parameters, points):
                yield _label(variant, base), checked(change_scenario(base, chosen | values))


def matrix_of(spec: SweepSpec) -> Matrix:
    """The missions of the sweep. Raises UserError as ``scenarios_of``."""
    fields = swept_fields(spec)
    return Matrix.of(scenarios_of(spec), seeds_of(spec), spec.sensor, fields, spec.results_version)


def differences(old: Any, new: Any, path: str = "") -> Iterator[str]:
    """The differences between two plain values, such as ``seeds: 10 there, 20 here``."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in dict.fromkeys([*old, *new]):
            yield from differences(old.get(key), new.get(key), f"{path}.{key}" if path else str(key))
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, f"{path}[{index}]")
    elif old != new:
        yield f"{path}: {_shown(old)} there, {_shown(new)} here"


def _per_strategy(spec: SweepSpec) -> list[tuple[str | None, Parameters, Points]]:
    """Strategy (None for the scenario's own), parameters and points of each part of the sweep."""
    if spec.strategies is None:
        return [(None, spec.parameters, spec.points)]
    return [
        (s.strategy, spec.parameters, spec.points)
        if s.parameters is None and s.points is None
        else (s.strategy, s.parameters or {}, s.points or [])
        for s in spec.strategies
    ]


def _combinations(parameters: Parameters, points: Points) -> Iterator[dict[str, Any]]:
    if parameters or not points:
        for values in itertools.product(*parameters.values()):
            yield dict(zip(parameters, values, strict=True))
    yield from points


def _count(parameters: Parameters, points: Points) -> int:
    combinations = math.prod(len(values) for values in parameters.values())
    return len(points) + (combinations if parameters or not points else 0)


def _scenario(variant: Variant, folder: Path) -> Scenario:
    """The variant's scenario with its changes. Relative paths start at ``folder``."""
    if isinstance(variant.scenario, dict):
        base = validated(Scenario, variant.scenario, "scenarios")
    elif variant.scenario in list_scenarios():
        base = load_scenario(variant.scenario)
    else:
        base = load_scenario((folder / Path(os.path.expanduser(variant.scenario))).absolute())
    return with_paths_beside(change_scenario(base, with_nulls(variant.changes), folder), folder)


def _label(variant: Variant, scenario: Scenario) -> str:
    return f"{scenario.name}-{variant.label}" if variant.label else scenario.name


def _written_out(spec: SweepSpec, folder: Path) -> list[Variant]:
    """Each scenario in full, so that the sweep depends on no other file."""
    whole: dict[str, Variant] = {}
    for index, variant in enumerate(spec.scenarios):
        scenario = _scenario(variant, folder)
        label = _label(variant, scenario)
        if label in whole:
            raise UserError(f"scenarios[{index}]: there is a '{label}' already; write another label")
        fields = parse_yaml(dump_scenario(scenario), label)
        whole[label] = Variant(scenario=fields, label=variant.label, set={})
    return list(whole.values())


def _with_values_beside(spec: SweepSpec, folder: Path) -> SweepSpec:
    """The sweep with the paths among its values resolved against ``folder``."""

    def beside(part: Part) -> Part:
        parameters, points = part.parameters, part.points
        return part.model_copy(
            update={
                "parameters": parameters
                and {f: [value_beside(folder, f, v) for v in values] for f, values in parameters.items()},
                "points": points
                and [{f: value_beside(folder, f, v) for f, v in point.items()} for point in points],
            }
        )

    strategies = spec.strategies and [beside(strategy) for strategy in spec.strategies]
    return beside(spec).model_copy(update={"strategies": strategies})


def _check_field(field: str) -> None:
    """Raises ValueError, with the nearest names, where a scenario has no such field to vary."""
    if field.startswith(OWN):  # which depends on the strategy: scenarios_of asks it
        return
    if field in _OWN_PLACE:
        raise ValueError(f"{field}: is not a parameter of a sweep; write it under {_OWN_PLACE[field]}")
    known = {
        name: info.description or ""
        for name, info in leaf_fields(Scenario)
        if "list" not in str(info.annotation) and "tuple" not in str(info.annotation)
    }
    if field in known:
        return
    leaves: dict[str, list[str]] = {}
    for name in known:
        leaves.setdefault(name.rpartition(".")[2], []).append(name)
    leaf = field.rpartition(".")[2]
    meant = [name for name, description in known.items() if description == leaf]
    close = [name for near in difflib.get_close_matches(leaf, leaves, n=2) for name in leaves[near]]
    found = [*meant, *leaves.get(leaf, ()), *difflib.get_close_matches(field, known, n=3), *close]
    nearest = list(dict.fromkeys(found))[:3]
    hint = f"did you mean {' or '.join(nearest)}?" if nearest else "see 'skysweep scenarios show'"
    raise ValueError(f"{field}: a scenario has no such parameter; {hint}")


def _shown(value: Any) -> str:
    if value is None:
        return "nothing"
    text = yaml.safe_dump(value, default_flow_style=True, width=1000).split("\n")[0]
    return text if len(text) <= 60 else text[:57] + "..."
