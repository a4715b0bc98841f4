"""Scenario files: YAML in, YAML out, and what is wrong with one said in a sentence.

Everything that a user can mend raises UserError naming the file, the field and what to write instead.
"""

from __future__ import annotations

import difflib
import os
import re
import typing
from collections.abc import Mapping
from contextlib import suppress
from functools import reduce
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from skysweep.errors import UserError
from skysweep.files.plain_yaml import MAX_YAML_BYTES, parse_yaml
from skysweep.files.reading import read_text_limited
from skysweep.files.writing import replace_file
from skysweep.scenarios.model import Scenario


class _PlainDumper(yaml.SafeDumper):
    """Writes every value where it stands, without anchors, as the loader wants it."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, text: str) -> yaml.ScalarNode:
        """Text that holds Unicode's own line ends is escaped: PyYAML would read them as blanks."""
        style = '"' if re.search("[\x85\u2028\u2029]", text) else None
        return self.represent_scalar("tag:yaml.org,2002:str", text, style)


_PlainDumper.add_representer(str, _PlainDumper.represent_text)


def list_scenarios() -> list[str]:
    """Names of the shipped scenarios, sorted."""
    return sorted(f.name.removesuffix(".yaml") for f in _shipped().iterdir() if f.name.endswith(".yaml"))


def load_scenario(name_or_path: str | Path) -> Scenario:
    """A shipped scenario by its name, or one from a YAML file.

    Relative paths of ``area.file``, ``search.plan``, ``detector.model`` and ``detector.statistical_model``
    count from the scenario file's folder.

    Raises:
        UserError: not found, not readable as plain YAML, or not a valid scenario.
    """
    name = str(name_or_path)
    if name in list_scenarios():
        return parse_scenario(_shipped().joinpath(f"{name}.yaml").read_text("utf-8"), f"{name}.yaml")
    path = Path(os.path.expanduser(name))
    scenario = parse_scenario(_read_text(path), str(path), path.parent)
    return with_paths_beside(scenario, path.parent)


def with_paths_beside(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with its relative paths counted from ``folder``."""
    updates: dict[str, Any] = {}
    if scenario.search.plan is not None:
        plan = str(folder / Path(os.path.expanduser(scenario.search.plan)))
        updates["search"] = scenario.search.model_copy(update={"plan": plan})
    detector, beside = scenario.detector, {}
    if detector.model.lower().endswith(".onnx"):
        beside["model"] = str(folder / Path(os.path.expanduser(detector.model)))
    if detector.statistical_model is not None:
        beside["statistical_model"] = str(folder / Path(os.path.expanduser(detector.statistical_model)))
    if beside:
        updates["detector"] = detector.model_copy(update=beside)
    return scenario.model_copy(update=updates)


def parse_scenario(text: str, source: str, folder: Path = Path()) -> Scenario:
    """A scenario from YAML text; ``source`` names it in errors, ``area.file`` counts from ``folder``.

    Raises:
        UserError: not plain YAML, or not a valid scenario.
    """
    data = _with_area_read(_fields_of(text, source), source, folder)
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise explain(error, source) from None


def change_scenario(scenario: Scenario, changes: Mapping[str, Any]) -> Scenario:
    """A copy with other values at dotted fields, such as ``search.n_c``; ``area.file`` is read.

    None leaves a field as it is.

    Raises:
        UserError: the change makes no valid scenario.
    """
    data = scenario.model_dump(by_alias=True)
    for dotted, value in changes.items():
        if value is not None:
            *parents, field = dotted.split(".")
            try:
                reduce(lambda node, key: node[key], parents, data)[field] = value
            except (KeyError, TypeError):
                raise UserError(
                    f"{scenario.name}: {dotted}: there is no such field; see 'skysweep scenarios show'"
                ) from None
    data = _with_area_read(data, scenario.name, Path())
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        raise explain(error, scenario.name) from None


def dump_scenario(scenario: Scenario) -> str:
    """The whole scenario as YAML, defaults included: ``parse_scenario`` gives the same one back."""
    return yaml.dump(
        scenario.model_dump(by_alias=True),
        Dumper=_PlainDumper,
        sort_keys=False,
        default_flow_style=None,
        allow_unicode=True,
        width=100,
    )


def write_scenario(scenario: Scenario, path: str | Path) -> Path:
    """Writes the scenario to ``path``, whole or not at all, and returns the path.

    Raises:
        UserError: the folder is missing or cannot be written to.
    """
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


def explain(error: ValidationError, source: str) -> UserError:
    """What pydantic found, as one sentence: the first wrong field and what to write instead.

    Unknown fields come first: a misspelt one is also reported as missing.
    """
    by_path: dict[tuple[str | int, ...], list[ErrorDetails]] = {}
    for detail in sorted(error.errors(), key=lambda d: d["type"] != "extra_forbidden"):
        by_path.setdefault(_location(detail), []).append(detail)
    location, details = next(iter(by_path.items()))
    sentence = _sentence(location, details)
    if len(by_path) > 1:
        sentence += f" ({len(by_path) - 1} more like this)" if len(by_path) > 2 else " (1 more like this)"
    return UserError(f"{source}: {sentence}")


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


def _fields_of(text: str, source: str) -> dict[str, Any]:
    data = parse_yaml(text, source)
    if not isinstance(data, dict):
        found = "empty" if data is None else f"a {type(data).__name__}"
        raise UserError(f"{source}: is {found}, not a scenario; write fields such as  name: my-search")
    return data


def _with_area_read(data: dict[str, Any], source: str, folder: Path) -> dict[str, Any]:
    """The fields of a scenario with the corners in the place of ``area.file``."""
    match data.get("area"):
        case {"file": str(name), **others} if not others:
            from skysweep.planning.area_files import read_corners

            try:
                polygon, holes = read_corners(folder / Path(os.path.expanduser(name)))
            except UserError as error:
                raise UserError(f"{source}: area.file: {error}") from None
            return data | {"area": {"polygon_lat_lon_deg": polygon, "holes_lat_lon_deg": holes}}
    return data


def _without_infinity(node: Any) -> Any:
    """JSON has no infinity: such a default is said in YAML's words."""
    if isinstance(node, dict):
        return {key: _without_infinity(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_without_infinity(value) for value in node]
    return ".inf" if node == float("inf") else node


def _location(detail: ErrorDetails) -> tuple[str | int, ...]:
    """The error's path in the file, without the name that pydantic gives to the arm of a union."""
    arm = detail["type"] == "literal_error" and str(detail["loc"][-1]).startswith("literal[")
    return detail["loc"][:-1] if arm else detail["loc"]


def _dotted(location: tuple[str | int, ...]) -> str:
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return path.removeprefix(".")


def _sentence(location: tuple[str | int, ...], details: list[ErrorDetails]) -> str:
    detail = details[0]
    kind, value = detail["type"], detail["input"]
    path = _dotted(location)
    shown = repr(value) if isinstance(value, str) else str(value)
    if len(shown) > 60:
        shown = shown[:57] + "..."
    if kind == "value_error":
        reason = str(detail["ctx"]["error"])
        names_field = re.match(r"[a-z_]+(\.[a-z_]+)*: ", reason)
        return reason if not path else f"{path}{'.' if names_field else ': '}{reason}"
    if kind == "extra_forbidden":
        return f"{path}: there is no such field; {_field_hint(location)}"
    if kind == "missing":
        if isinstance(location[-1], int):
            return f"{_dotted(location[:-1])}: is too short; write two numbers, such as [12.5, 40]"
        return f"{path}: is missing; {_missing_hint(location)}"
    if kind == "literal_error":
        choices = [c for d in details for c in re.findall(r"'([^']*)'", d["ctx"]["expected"])]
        near = difflib.get_close_matches(str(value), choices, n=1)
        start = f"did you mean '{near[0]}'? " if near else ""
        return f"{path}: {shown} is not known; {start}write one of {', '.join(choices)}"
    if kind == "string_pattern_mismatch":
        return f"{path}: {shown} does not do; write letters and digits, with spaces and . _ - between"
    if kind in ("model_type", "dict_type"):
        what = "is empty" if value is None else f"is {shown}"
        return f"{path}: {what}; write its fields indented below it, or delete the line"
    if kind == "too_short":
        return f"{path}: is empty; write at least {detail['ctx']['min_length']}, or delete the line"
    if kind == "too_long":
        ctx = detail["ctx"]
        at_most = "" if ctx["field_type"] == "Tuple" else "at most "
        return f"{path}: has {ctx['actual_length']} values; write {at_most}{ctx['max_length']}"
    instead = re.sub(r"^(Input|String|List|Tuple) should (be|have) ", "", detail["msg"]).split(",")[0]
    instead = re.sub(r"^(greater|less) than", r"a number \1 than", instead)
    return f"{path}: is {'empty' if value is None else shown}; write {instead}"


def _field_hint(location: tuple[str | int, ...]) -> str:
    known = [field.alias or name for name, field in _model_at(location[:-1]).model_fields.items()]
    near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
    return f"did you mean '{near[0]}'?" if near else f"write one of {', '.join(known)}"


def _missing_hint(location: tuple[str | int, ...]) -> str:
    field = _field(_model_at(location[:-1]), location[-1])
    inner = _model_in(field.annotation)
    if inner is not None:
        return f"add it with fields such as {', '.join(list(inner.model_fields)[:2])}"
    return f"add  {location[-1]}: ..." + (f"  ({field.description})" if field.description else "")


def _model_at(location: tuple[str | int, ...]) -> type[BaseModel]:
    model: type[BaseModel] = Scenario
    for part in location:
        if isinstance(part, str):
            inner = _model_in(_field(model, part).annotation)
            assert inner is not None, f"{part} holds no fields"
            model = inner
    return model


def _field(model: type[BaseModel], alias: str | int) -> Any:
    return next(f for name, f in model.model_fields.items() if alias in (name, f.alias))


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((m for a in typing.get_args(annotation) if (m := _model_in(a))), None)
