#!/usr/bin/env python3
"""Writes the field reference into docs/scenarios.md from the JSON schema:  tools/scenario_reference.py"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from skysweep.scenarios.files import json_schema

PAGE = Path(__file__).parents[1] / "docs" / "scenarios.md"
BEGIN, END = "<!-- fields: begin -->\n", "<!-- fields: end -->\n"


def with_reference(page: str) -> str:
    """The page with its field reference made anew."""
    before, rest = page.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{reference(json_schema())}\n{END}{after}"


def reference(schema: dict[str, Any]) -> str:
    """Markdown tables: the scenario's own fields, then every section in the order of its first use."""
    parts = [_table("Scenario", schema)]
    waiting, done = _sections(schema), set[str]()
    while waiting:
        name = waiting.pop(0)
        if name not in done:
            done.add(name)
            section = schema["$defs"][name]
            parts.append(_table(name, section))
            waiting = [*_sections(section), *waiting]
    return "\n".join(parts)


def _table(name: str, section: dict[str, Any]) -> str:
    lines = [f"### {name}", "", section["description"].replace("``", "`"), ""]
    lines += ["| field | value | default | meaning |", "|---|---|---|---|"]
    required = section.get("required", [])
    for field, spec in section["properties"].items():
        default = "required" if field in required else _default(spec)
        lines.append(f"| `{field}` | {_value(spec)} | {default} | {spec.get('description', '')} |")
    return "\n".join([*lines, ""])


def _value(spec: dict[str, Any]) -> str:
    if "$ref" in spec:
        name = spec["$ref"].rsplit("/", 1)[1]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in spec or "oneOf" in spec:
        options = spec.get("anyOf", spec.get("oneOf", []))
        choices = [_value(s) for s in options if s.get("type") != "null"]
        return " or ".join(choices)
    if "const" in spec:
        return f"`{spec['const']}`"
    if "enum" in spec:
        return ", ".join(f"`{choice}`" for choice in spec["enum"])
    if "prefixItems" in spec:
        return f"[{', '.join(_value(item) for item in spec['prefixItems'])}]"
    if spec["type"] == "array":
        return f"list of {_value(spec['items'])}"
    if spec["type"] == "object":
        return f"{_value(spec['additionalProperties'])}, by name"
    if spec["type"] == "string":
        return "text"
    if spec["type"] == "boolean":
        return "`true`, `false`"
    return {"number": "number", "integer": "whole number"}[spec["type"]] + _range(spec)


def _range(spec: dict[str, Any]) -> str:
    if "minimum" in spec and "maximum" in spec:
        return f" {spec['minimum']:g} to {spec['maximum']:g}"
    signs = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}
    limits = [f"{sign}{spec[key]:g}" for key, sign in signs.items() if key in spec]
    return f" {', '.join(limits)}" if limits else ""


def _default(spec: dict[str, Any]) -> str:
    if "$ref" in spec:
        return "its defaults"
    default = spec.get("default")
    if default is None:
        return "none"
    if default == "":
        return "empty"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


def _sections(section: dict[str, Any]) -> list[str]:
    return list(_references(section["properties"]))


def _references(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        if "$ref" in node:
            yield node["$ref"].rsplit("/", 1)[1]
        for value in node.values():
            yield from _references(value)
    elif isinstance(node, list):
        for value in node:
            yield from _references(value)


if __name__ == "__main__":
    PAGE.write_text(with_reference(PAGE.read_text("utf-8")), "utf-8")
