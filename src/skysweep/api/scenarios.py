"""Scenarios in Python: load, build, change."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

from pydantic import BaseModel

from skysweep.errors import UserError
from skysweep.files.models import validated
from skysweep.scenarios import files
from skysweep.scenarios.model import Model, Scenario

ScenarioLike: TypeAlias = Scenario | str | Path  # itself, its name, or the path of its file


def load_scenario(name_or_path: ScenarioLike) -> Scenario:
    """A shipped scenario by its name, or one from a YAML file; a ``Scenario`` is returned unchanged.

    Raises UserError if there is none, or the file is no valid scenario.
    """
    if isinstance(name_or_path, Scenario):
        return name_or_path
    if not isinstance(name_or_path, str | Path):
        raise UserError(
            f"scenario: is {name_or_path!r:.60}; give a name such as 'clusters', the path of a YAML file, or "
            "a Scenario"
        )
    return files.load_scenario(name_or_path)


def make_scenario(**fields: Any) -> Scenario:
    """A scenario with these fields, as in a scenario file; parts may be dicts or objects.

    Raises UserError if they make no valid scenario.

    Example:
        >>> make_scenario(name="field", area={"polygon_enu_m": [[0, 0], [60, 0], [60, 40], [0, 40]]}).name
        'field'
    """
    plain = {name: _plain(value) for name, value in fields.items()}
    return validated(Scenario, plain, str(fields.get("name", "scenario")))


def change_scenario(scenario: ScenarioLike, changes: Mapping[str, Any]) -> Scenario:
    """A copy with other values at dotted fields, such as ``{"search.n_c": 3}``.

    A dict changes the fields of a section that it names, as ``{"search": {"n_c": 3}}``; ``area``, a list or
    an object is changed as a whole. Raises UserError if a field is unknown or written twice, or the result is
    no valid scenario.
    """
    if not isinstance(changes, Mapping):
        raise UserError(
            f"changes: is {changes!r:.60}; write a dict of dotted fields, such as {{'search.n_c': 3}}"
        )
    given = {k: v if isinstance(v, Model) else _plain(v) for k, v in changes.items()}
    return files.change_scenario(load_scenario(scenario), files.with_nulls(given))


def _plain(value: Any) -> Any:
    """Plain data instead of objects, so that everything is validated again."""
    if isinstance(value, BaseModel):
        return value.model_dump(by_alias=True)
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    return value
