"""Pydantic models from what users write; a mistake in it is one sentence."""

from __future__ import annotations

import difflib
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
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
    location, holder, field = _found(model, location)
    path = dotted(location)
    shown = repr(value) if isinstance(value, str) else str(value)
    if len(shown) > 60:
        shown = shown[:57] + "..."
    if kind == "value_error":
        reason = str(detail["ctx"]["error"])
        names_field = re.match(r"[a-z_]+(\.[a-z_]+)*: ", reason)
        return reason if not path else f"{path}{'.' if names_field else ': '}{reason}"
    if kind == "extra_forbidden":
        return f"{path}: there is no such field; {_field_hint(holder, str(location[-1]))}"
    if kind == "missing":
        if isinstance(location[-1], int):
            return f"{dotted(location[:-1])}: is too short; write two numbers, such as [12.5, 40]"
        return f"{path}: is missing; {_missing_hint(str(location[-1]), field)}"
    if kind == "literal_error":
        choices = [c for d in details for c in re.findall(r"'([^']*)'", d["ctx"]["expected"])]
        return f"{path}: {shown} is not known; {_choice(str(value), choices)}"
    if kind == "union_tag_invalid":
        (name, tags), tag = _tags(field), detail["ctx"]["tag"]
        return f"{path}.{name}: '{tag}' is not known; {_choice(tag, tags)}"
    if kind == "union_tag_not_found":
        name, tags = _tags(field)
        return f"{path}.{name}: is missing; write one of {', '.join(tags)}"
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
    if kind == "model_attributes_type":
        name, tags = _tags(field)
        return f"{path}: {found}; write {name} ({', '.join(tags)}) and its fields indented below it"
    if kind in ("model_type", "dict_type"):
        return f"{path}: {found}; write its fields indented below it, or delete the line"
    words = _words(field)
    if kind == "list_type" and words:
        return f"{path}: {found}; write a list such as [{words[0]}], of {', '.join(words)}"
    if kind == "tuple_type":
        return f"{path}: {found}; write a list of numbers, such as [12.5, 40]"
    instead = re.sub(r"^(Input|String|List|Tuple) should (be|have) ", "", detail["msg"]).split(",")[0]
    instead = re.sub(r"^(greater|less) than", r"a number \1 than", instead)
    return f"{path}: {found}; write {instead}"


def _choice(word: str, choices: Sequence[str]) -> str:
    near = difflib.get_close_matches(word, choices, n=1)
    start = f"did you mean '{near[0]}'? " if near else ""
    return f"{start}write one of {', '.join(choices)}"


def _field_hint(holder: type[BaseModel], name: str) -> str:
    known = [field.alias or name for name, field in holder.model_fields.items()]
    if not known:
        return "leave it out"
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean '{near[0]}'?" if near else f"write one of {', '.join(known)}"


def _missing_hint(name: str, field: FieldInfo | None) -> str:
    assert field is not None, f"{name} is not known, so that it cannot be missing"
    inner = _models_in(field.annotation)
    if inner:
        return f"add it with fields such as {', '.join(list(inner[0].model_fields)[:2])}"
    return f"add  {name}: ..." + (f"  ({field.description})" if field.description else "")


def _found(model: type[BaseModel], location: Location) -> tuple[Location, type[BaseModel], FieldInfo | None]:
    """A location without the tags of unions, the model that holds its last field, and the field if known."""
    shown: list[str | int] = []
    arms, field = [model], None
    for part in location:
        if isinstance(part, str) and len(arms) > 1:
            arms = [arm for arm in arms if part in _tag(arm)[1]]
            continue
        shown.append(part)
        if isinstance(part, str) and arms:
            model = arms[0]
            field = next((f for name, f in model.model_fields.items() if part in (name, f.alias)), None)
            arms = [] if field is None else _models_in(field.annotation)
    return tuple(shown), model, field


def _tags(field: FieldInfo | None) -> tuple[str, list[str]]:
    """The field that tells the models of a tagged union apart, and its values."""
    tags = [_tag(arm) for arm in _models_in(field and field.annotation)]
    return tags[0][0], [value for _, values in tags for value in values]


def _tag(arm: type[BaseModel]) -> tuple[str, tuple[str, ...]]:
    return next(
        (name, typing.get_args(field.annotation))
        for name, field in arm.model_fields.items()
        if field.is_required() and typing.get_origin(field.annotation) is typing.Literal
    )


def _words(field: FieldInfo | None) -> tuple[str, ...]:
    """The words that the items of a list may be."""
    lists = (arm for arm in union_arms(field and field.annotation) if typing.get_origin(arm) is list)
    items = (typing.get_args(arm)[0] for arm in lists)
    return next((typing.get_args(item) for item in items if typing.get_origin(item) is typing.Literal), ())


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if _is_model(annotation):
        return [annotation]
    return [model for inner in typing.get_args(annotation) for model in _models_in(inner)]


def _is_model(kind: Any) -> typing.TypeGuard[type[BaseModel]]:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
