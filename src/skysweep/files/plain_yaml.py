"""YAML from users: plain values only, checked before anything is built from them."""

from __future__ import annotations

import re
from collections.abc import Hashable, Iterator
from typing import Any

import yaml

from skysweep.errors import UserError

MAX_YAML_BYTES = 5_000_000
MAX_VALUES = 250_000
MAX_NESTING = 20
_TOO_DEEP = "lists are nested too deeply; check the brackets"

_FastLoader: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _PlainLoader(_FastLoader):  # type: ignore[valid-type, misc]
    """Allows only YAML's own types, and each key once."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            problem = None
            if key.tag != "tag:yaml.org,2002:str":
                problem = "a field's name must be a word; put it in quotes if it is one"
            elif key.value in seen:
                problem = f"'{key.value}' is written twice; keep one"
            if problem:
                raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
            seen.add(key.value)
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep=deep)
        return mapping


class _PlainDumper(yaml.SafeDumper):
    """Writes every value in place, without anchors, as the loader wants it."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, text: str) -> yaml.ScalarNode:
        """Escape text with Unicode line ends, which PyYAML would read as blanks."""
        style = '"' if re.search("[\x85\u2028\u2029]", text) else None
        return self.represent_scalar("tag:yaml.org,2002:str", text, style)


_PlainDumper.add_representer(str, _PlainDumper.represent_text)


def dump_yaml(data: Any) -> str:
    """Plain data as YAML; ``parse_yaml`` reads it back."""
    return yaml.dump(
        data, Dumper=_PlainDumper, sort_keys=False, default_flow_style=None, allow_unicode=True, width=100
    )


def parse_yaml(text: str, source: str) -> Any:
    """The value of plain YAML: no tags, no aliases, words as keys, no key twice.

    ``source`` names the text in errors. Raises UserError if it is anything else, or too large.
    """
    return _load(text, source, _PlainLoader)


def parse_fields(text: str, source: str, what: str, such_as: str) -> dict[str, Any]:
    """The fields of plain YAML. Raises UserError if it is no plain YAML, or no fields.

    Errors say ``what`` the fields make, and name some (``such_as``).
    """
    data = parse_yaml(text, source)
    if not isinstance(data, dict):
        found = "empty" if data is None else f"a {type(data).__name__}"
        raise UserError(f"{source}: is {found}, not a {what}; write fields such as  {such_as}")
    return data


def parse_foreign_yaml(text: str, source: str) -> Any:
    """Like :func:`parse_yaml`, for files of other programs, whose keys may be numbers."""
    return _load(text, source, _FastLoader)


def _load(text: str, source: str, loader: type[yaml.SafeLoader]) -> Any:
    try:
        for problem, line in _forbidden(text):
            raise UserError(f"{source}: line {line}: {problem}")
        return yaml.load(text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        at = error.problem_mark or error.context_mark
        where = f"line {at.line + 1}: " if at else ""
        if "nesting depth" in str(error.problem):  # of libyaml: it reads ahead of the events counted here
            raise UserError(f"{source}: {where}{_TOO_DEEP}") from None
        if isinstance(error, yaml.constructor.ConstructorError):
            raise UserError(f"{source}: {where}{error.problem}") from None
        raise UserError(
            f"{source}: {where}not YAML ({error.problem or error.context}); "
            "check the indentation, quotes and brackets there, and that nothing is missing at the end"
        ) from None
    except (yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{source}: not YAML ({reason}); write it as plain text") from None


def _forbidden(text: str) -> Iterator[tuple[str, int]]:
    """What plain YAML does not allow, and on which line."""
    depth = values = 0
    for event in yaml.parse(text, Loader=_FastLoader):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, yaml.AliasEvent):
            yield f"the alias *{event.anchor} is not allowed; write the value out", line
        elif isinstance(event, (yaml.ScalarEvent, yaml.CollectionStartEvent)):
            if event.tag:
                yield f"the YAML tag {event.tag} is not allowed; write a plain value", line
            values += 1
            if values > MAX_VALUES:
                yield f"holds more than {MAX_VALUES:,} values, too many to read; leave some out", line
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > MAX_NESTING:
                yield _TOO_DEEP, line
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
