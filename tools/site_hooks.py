"""What the documentation site takes from outside docs/: the root's pages, the commands, links to sources."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from inspect import cleandoc
from pathlib import Path
from posixpath import dirname, join, normpath, relpath
from types import ModuleType
from typing import Any

import typer
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from skysweep.cli import app

# The wheel of pixeltable-yolox (extra train) names templates for mkdocstrings that it does not hold.
_templates = sys.modules["tool.doc_plugins.mkdocstrings"] = ModuleType("tool.doc_plugins.mkdocstrings")
_templates.get_templates_path = lambda: Path(__file__).parent  # type: ignore[attr-defined]

ROOT = Path(__file__).parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
REPOSITORY = "https://github.com/skysweep/skysweep/blob/main"
COMMANDS = "reference/cli.md"

LINK = re.compile(r"(!?\[[^\]]*\]\()([^)#\s]*)(#[^)\s]*)?\)")
FENCE = re.compile(r"(^```.*?^```)", re.MULTILINE | re.DOTALL)
LOADED = re.compile(
    r"<(?:script|img|iframe|source|link(?! rel=\"?(?:canonical|edit)))[^>]*"
    r"(?:src|href)=\"?((?:https?:)?//[^\"\s>]+)"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages that are written elsewhere."""
    for source, page in PAGES.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text("utf-8")))
    files.append(File.generated(config, COMMANDS, content=command_reference()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Links lead to the site's page where it has one, else to the repository."""
    source = next((root for root, name in PAGES.items() if name == page.file.src_uri), None)
    return with_links(markdown, source or f"docs/{page.file.src_uri}", page.file.src_uri)


def on_post_build(config: MkDocsConfig) -> None:
    """Nothing is fetched when the site is read."""
    for path in Path(config.site_dir).rglob("*.html"):
        if fetched := LOADED.search(path.read_text("utf-8")):
            raise PluginError(f"{path.name} loads {fetched[1]}; keep a copy in docs/assets instead")


def with_links(markdown: str, source: str, page: str) -> str:
    """A page's text with links for the site. ``source`` is its path from the root, ``page`` from docs/."""

    def mended(link: re.Match[str]) -> str:
        before, target, anchor = link[1], link[2], link[3] or ""
        if not target or "://" in target or target.startswith("mailto:"):
            return link[0]
        path = normpath(join(dirname(source), target))
        if path.startswith("docs/data/") or (not path.startswith("docs/") and path not in PAGES):
            exists = (ROOT / path).exists()
            return f"{before}{REPOSITORY}/{path}{anchor})" if exists else link[0]
        inside = PAGES.get(path, path.removeprefix("docs/"))
        return f"{before}{relpath(inside, dirname(page) or '.')}{anchor})"

    pieces = FENCE.split(markdown)
    pieces[::2] = [LINK.sub(mended, text) for text in pieces[::2]]
    return "".join(pieces)


def command_reference() -> str:
    """Every command with its arguments, options and examples, from the commands themselves."""
    lines = ["# Commands", "", "The same text as `skysweep COMMAND --help`.", ""]
    for name, command in _leaves(typer.main.get_command(app), "skysweep"):
        lines += [f"## {name}", "", _help(command.help or ""), ""]
        rows = [_row(parameter) for parameter in command.params if not parameter.hidden]
        if rows:
            lines += ["| argument or option | default | meaning |", "|---|---|---|", *rows, ""]
    return "\n".join(lines)


def _leaves(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    inner = getattr(command, "commands", None)
    if inner is None:
        yield name, command
    for key, subcommand in (inner or {}).items():
        yield from _leaves(subcommand, f"{name} {key}")


def _help(text: str) -> str:
    what, _, examples = cleandoc(text).partition("Examples:")
    lines = [line.strip() for line in examples.splitlines() if line.strip()]
    return "\n".join([what.strip(), "", "```bash", *lines, "```"]) if lines else what.strip()


def _row(parameter: Any) -> str:
    if parameter.param_type_name == "option":
        name = " ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    else:
        name = f"`{parameter.metavar or parameter.name.upper()}`"
    default = parameter.default
    shown = "" if default in (None, False, (), []) else f"`{default}`"
    meaning = (parameter.help or "").replace("|", "\\|")
    return f"| {name} | {'required' if parameter.required else shown} | {meaning} |"
