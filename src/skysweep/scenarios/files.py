"""Scenario files: read from YAML and written as YAML.

A mistake in one raises UserError, a sentence with the file, the field and what to write instead.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Any, Final

from skysweep.errors import UserError
from skysweep.files.models import validated
from skysweep.files.plain_yaml import MAX_YAML_BYTES, dump_yaml, parse_fields
from skysweep.files.reading import read_text_limited
from skysweep.files.writing import replace_file
from skysweep.scenarios.model import OWN_DETECTORS, Area, Model, Scenario

_OURS = "shipped:"
_OF_TERRAIN = ("dem", "land_cover", "orthophoto")
_FILES = {
    *("search.plan", "detector.model", "detector.statistical_model", "buildings_file", "roads_file"),
    *(f"terrain.{field}" for field in _OF_TERRAIN),
}


def list_scenarios() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    return sorted(f.name.removesuffix(".yaml") for f in _shipped().iterdir() if f.name.endswith(".yaml"))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """A shipped scenario by its name, or one from a YAML file.

    Relative paths of ``area.file``, ``search.plan``, ``detector.model``, ``detector.statistical_model`` and
    the ground's files start at the scenario file's folder, and are absolute in what is returned, so that it
    can be written elsewhere. Raises UserError if the scenario is not found, is
    not plain YAML or is invalid.
    """
    name = str(name_or_path)
    if name in list_scenarios():
        return parse_scenario(_shipped().joinpath(f"{name}.yaml").read_text("utf-8"), f"{name}.yaml")
    path = Path(os.path.expanduser(name))
    scenario = parse_scenario(_read_text(path), str(path), path.parent)
    return with_paths_beside(scenario, path.parent.absolute())


def with_paths_beside(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with its relative paths resolved against ``folder``."""
    search, detector = scenario.search, scenario.detector
    if search.plan is not None:
        search = search.model_copy(update={"plan": str(_beside(folder, search.plan))})
    if detector.model.lower().endswith(".onnx"):
        detector = detector.model_copy(update={"model": str(_beside(folder, detector.model))})
    if detector.statistical_model is not None:
        fitted = str(_beside(folder, detector.statistical_model))
        detector = detector.model_copy(update={"statistical_model": fitted})
    given = {field: str(_beside(folder, name)) for field, name in _ground_names(scenario).items()}
    terrain = scenario.terrain.model_copy(update={f: given.pop(f) for f in _OF_TERRAIN if f in given})
    return scenario.model_copy(update={"search": search, "detector": detector, "terrain": terrain, **given})


def value_beside(folder: Path, field: str, value: Any) -> Any:
    """The value of a dotted field, resolved against ``folder`` where it is a relative path."""
    is_name = value == NULL or (field == "detector.model" and not str(value).lower().endswith(".onnx"))
    if field not in _FILES or not isinstance(value, str) or is_name:
        return value
    return str(_beside(folder, value))


def ground_files(scenario: Scenario) -> dict[str, Path]:
    """The files that a scenario's ground is made from, by field."""
    return {
        f"terrain.{field}" if field in _OF_TERRAIN else field: ground_file(name)
        for field, name in _ground_names(scenario).items()
    }


def ground_file(name: str) -> Path:
    """A file of the ground; ``shipped:NAME`` comes with skysweep, so that its name is the same everywhere."""
    return Path(str(_shipped())) / name.removeprefix(_OURS) if name.startswith(_OURS) else Path(name)


def _ground_names(scenario: Scenario) -> dict[str, str]:
    names = {field: getattr(scenario.terrain, field) for field in _OF_TERRAIN}
    names |= {field: getattr(scenario, field) for field in ("buildings_file", "roads_file")}
    return {field: name for field, name in names.items() if name is not None}


def _beside(folder: Path, name: str) -> Path:
    return Path(name) if name.startswith(_OURS) else folder / os.path.expanduser(name)


NULL: Final = "null"  # as a value of ``change_scenario``, where None changes nothing; files can hold it


def parse_scenario(text: str, source: str, folder: Path = Path()) -> Scenario:
    """A scenario from YAML text; ``source`` names it in errors, ``area.file`` is relative to ``folder``.

    Raises UserError if the text is not plain YAML or no valid scenario.
    """
    fields = parse_fields(text, source, "scenario", "name: my-search")
    return validated(Scenario, _with_area_read(fields, source, folder), source)


def change_scenario(scenario: Scenario, changes: Mapping[str, Any], folder: Path = Path()) -> Scenario:
    """A copy with other values at dotted fields, such as ``search.n_c``; ``folder`` has ``area.file``.

    None leaves a field unchanged, ``NULL`` makes it null. A mapping changes the fields of a section that it
    names, but ``area``, a list or a model is changed as a whole. Raises UserError if a field is unknown or
    written twice, or the result is no valid scenario.
    """
    data = scenario.model_dump(by_alias=True)
    fields = _spelt_out(scenario, changes)
    if fields.get("camera.kind", scenario.camera.kind) != scenario.camera.kind:
        _leave_open(data, scenario)
    for dotted in sorted(fields, key=lambda dotted: dotted.count(".")):  # a whole section before its fields
        *parents, field = dotted.split(".")
        try:
            reduce(lambda node, key: node[key], parents, data)[field] = fields[dotted]
        except (KeyError, TypeError):
            raise UserError(
                f"{scenario.name}: {dotted}: there is no such field; see 'skysweep scenarios show'"
            ) from None
    return validated(Scenario, _with_area_read(data, scenario.name, folder), scenario.name)


def with_nulls(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes in which None makes a field null, as where users write them."""
    return {field: NULL if value is None else value for field, value in changes.items()}


def _spelt_out(scenario: Scenario, changes: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values by dotted field, without those that change nothing."""
    fields: dict[str, Any] = {}
    for given, value in changes.items():
        held: Any = scenario
        for name in given.split("."):
            held = getattr(held, name, None)
        for dotted, each in _leaves(held, given, value) if value is not None else ():
            if dotted in fields:
                raise UserError(f"{scenario.name}: {dotted}: is written twice; keep one")
            fields[dotted] = None if isinstance(each, str) and each == NULL else each
    return fields


def _leaves(held: Any, dotted: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Model):
        yield dotted, value.model_dump(by_alias=True)
    elif isinstance(held, Model) and not isinstance(held, Area) and isinstance(value, Mapping):
        for name, each in value.items():
            yield from _leaves(getattr(held, str(name), None), f"{dotted}.{name}", each)
    else:
        yield dotted, value


def _leave_open(data: dict[str, Any], scenario: Scenario) -> None:
    """Take out what is usual for the kind of its camera, so that another kind has its own."""
    kind = scenario.camera.kind
    usual = type(scenario.camera)(kind=kind).model_dump(by_alias=True)
    data["camera"] = {k: v for k, v in data["camera"].items() if k not in usual or v != usual[k]}
    if data["detector"]["model"] == OWN_DETECTORS[kind]:
        del data["detector"]["model"]


def dump_scenario(scenario: Scenario) -> str:
    """The whole scenario as YAML, with defaults; ``parse_scenario`` reads the same scenario from it."""
    return dump_yaml(scenario.model_dump(by_alias=True))


def write_scenario(scenario: Scenario, path: str | Path) -> Path:
    """Write the scenario to ``path``, whole or not at all, and return the path.

    Raises UserError if it is no scenario, or the folder is missing or cannot be written to.
    """
    if not isinstance(scenario, Scenario):
        raise UserError(f"scenario: is {scenario!r:.60}; give a Scenario, as load_scenario returns")
    path = Path(os.path.expanduser(path))
    text = dump_scenario(scenario)
    try:
        replace_file(path, text.encode("utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be written ({error.strerror}); choose another place") from None
    return path


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of a scenario file, for editors and other tools."""
    schema = Scenario.model_json_schema(by_alias=True)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_without_infinity(schema)}


def _shipped() -> Any:
    return resources.files("skysweep.scenarios") / "shipped"


def _read_text(path: Path) -> str:
    with suppress(OSError):
        if not path.exists():
            raise UserError(f"{path}: there is no such scenario; {_shipped_hint(path.name)}")
    return read_text_limited(path, MAX_YAML_BYTES)


def _shipped_hint(name: str) -> str:
    shipped = list_scenarios()
    near = difflib.get_close_matches(name.removesuffix(".yaml"), shipped, n=1)
    start = f"did you mean '{near[0]}'? " if near else ""
    return f"{start}write the path of a YAML file or one of {', '.join(shipped)}"


def _with_area_read(data: dict[str, Any], source: str, folder: Path) -> dict[str, Any]:
    """The fields of a scenario with the corners of ``area.file`` in place of the file."""
    match data.get("area"):
        case {"file": str(name), **others} if not others:
            from skysweep.planning.area_files import read_corners

            try:
                polygon, holes = read_corners(_beside(folder, name))
            except UserError as error:
                raise UserError(f"{source}: area.file: {error}") from None
            return data | {"area": {"polygon_lat_lon_deg": polygon, "holes_lat_lon_deg": holes}}
    return data


def _without_infinity(node: Any) -> Any:
    """JSON has no infinity: such a default is written as in YAML."""
    if isinstance(node, dict):
        return {key: _without_infinity(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_without_infinity(value) for value in node]
    return ".inf" if node == float("inf") else node
