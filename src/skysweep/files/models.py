"""Pydantic models from what users write; a mistake in it is one sentence."""

from __future__ import annotations

import difflib
import re
import types
import typing
from collections.abc import Iterator, Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from skysweep.errors import UserError

AnyModel = TypeVar("AnyModel", bound=BaseModel)
Location = tuple[str | int, ...]

# Names that pydantic gives to the arms of a union, in an error's path.
_ARM = re.compile(r"bool|int|float|str|(literal|list|dict)\[.*")


def validated(
    model: type[AnyModel], data: Any, source: str, write: Mapping[str, str] | None = None
) -> AnyModel:
    """The model made from ``data``. Raises UserError with the first wrong field and what to write instead.

    ``source`` names the data in errors. ``write`` says what to write in a top-level field of a wrong type.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise UserError(f"{source}: {_explained(error, model, write or {})}") from None


def leaf_fields(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Dotted names of a model's fields, nested ones included, that hold no model themselves."""
    for name, field in model.model_fields.items():
        inner = next((kind for kind in union_arms(field.annotation) if _is_model(kind)), None)
        if inner is None:
            yield f"{prefix}{name}", field
        else:
            yield from leaf_fields(inner, f"{prefix}{name}.")


def union_arms(annotation: Any) -> tuple[Any, ...]:
    """The arms of a union, or the annotation itself."""
    is_union = typing.get_origin(annotation) in (typing.Union, types.UnionType)
    return typing.get_args(annotation) if is_union else (annotation,)


def dotted(location: Location) -> str:
    """A path in a file, such as ``scenarios[0].label``."""
    path = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return path.removeprefix(".")


def _explained(error: ValidationError, model: type[BaseModel], write: Mapping[str, str]) -> str:
    """Unknown fields come first, because a misspelt field is also reported as missing."""
    by_path: dict[Location, list[ErrorDetails]] = {}
    for detail in sorted(error.errors(), key=lambda d: d["type"] != "extra_forbidden"):
        location = tuple(part for part in detail["loc"] if not _ARM.fullmatch(str(part)))
        by_path.setdefault(location, []).append(detail)
    location, details = next(iter(by_path.items()))
    more = len(by_path) - 1
    return _sentence(location, details, model, write) + (f" ({more} more like this)" if more else "")


def _sentence(
    location: Location, details: list[ErrorDetails], model: type[BaseModel], write: Mapping[str, str]
) -> str:
    detail = details[0]
    kind, value = detail["type"], detail["input"]
    path = dotted(location)
    shown = repr(value) if isinstance(value, str) else str(value)
    if len(shown) > 60:
        shown = shown[:57] + "..."
    if kind == "value_error":
        reason = str(detail["ctx"]["error"])
        names_field = re.match(r"[a-z_]+(\.[a-z_]+)*: ", reason)
        return reason if not path else f"{path}{'.' if names_field else ': '}{reason}"
    if kind == "extra_forbidden":
        return f"{path}: there is no such field; {_field_hint(model, location)}"
    if kind == "missing":
        if isinstance(location[-1], int):
            return f"{dotted(location[:-1])}: is too short; write two numbers, such as [12.5, 40]"
        return f"{path}: is missing; {_missing_hint(model, location)}"
    if kind == "literal_error":
        choices = [c for d in details for c in re.findall(r"'([^']*)'", d["ctx"]["expected"])]
        near = difflib.get_close_matches(str(value), choices, n=1)
        start = f"did you mean '{near[0]}'? " if near else ""
        return f"{path}: {shown} is not known; {start}write one of {', '.join(choices)}"
    if kind == "string_pattern_mismatch":
        rule = "letters, digits, spaces and . _ -, a letter or digit first"
        return f"{path}: {shown} is not allowed; write {rule}"
    if kind == "too_short":
        return f"{path}: is empty; write at least {detail['ctx']['min_length']}, or delete the line"
    if kind == "too_long":
        ctx = detail["ctx"]
        at_most = "" if ctx["field_type"] == "Tuple" else "at most "
        return f"{path}: has {ctx['actual_length']} values; write {at_most}{ctx['max_length']}"
    found = "is empty" if value is None else f"is {shown}"
    if location[0] in write and kind.endswith(("_type", "_parsing")):
        return f"{path}: {found}; write {write[str(location[0])]}"
    if kind in ("model_type", "dict_type"):
        return f"{path}: {found}; write its fields indented below it, or delete the line"
    instead = re.sub(r"^(Input|String|List|Tuple) should (be|have) ", "", detail["msg"]).split(",")[0]
    instead = re.sub(r"^(greater|less) than", r"a number \1 than", instead)
    return f"{path}: {found}; write {instead}"


def _field_hint(model: type[BaseModel], location: Location) -> str:
    known = [field.alias or name for name, field in _model_at(model, location[:-1]).model_fields.items()]
    near = difflib.get_close_matches(str(location[-1]), known, n=1, cutoff=0.5)
    return f"did you mean '{near[0]}'?" if near else f"write one of {', '.join(known)}"


def _missing_hint(model: type[BaseModel], location: Location) -> str:
    field = _field(_model_at(model, location[:-1]), str(location[-1]))
    inner = _model_in(field.annotation)
    if inner is not None:
        return f"add it with fields such as {', '.join(list(inner.model_fields)[:2])}"
    return f"add  {location[-1]}: ..." + (f"  ({field.description})" if field.description else "")


def _model_at(model: type[BaseModel], location: Location) -> type[BaseModel]:
    for part in location:
        if isinstance(part, str):
            inner = _model_in(_field(model, part).annotation)
            assert inner is not None, f"{part} holds no fields"
            model = inner
    return model


def _field(model: type[BaseModel], alias: str) -> FieldInfo:
    return next(f for name, f in model.model_fields.items() if alias in (name, f.alias))


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if _is_model(annotation):
        return annotation
    return next((m for a in typing.get_args(annotation) if (m := _model_in(a))), None)


def _is_model(kind: Any) -> typing.TypeGuard[type[BaseModel]]:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
