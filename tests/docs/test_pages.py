"""Every code block of the documentation runs, in order, in a folder of its own for each page."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import yaml
from pages import PAGES, ROOT, Block, blocks

import skysweep as ss
from skysweep.experiments.sweep.spec import load_spec

OWN_FILES = Path(__file__).parent / "own"  # what a page takes from its reader: area.kml, my_module.py

RUN = {"bash", "python", "yaml"}
SHOWN = {"json", "text", "toml", "xml"}

# Blocks that are not run: the title above each says what it needs. Count a new one here.
NOT_RUN = {
    "Needs Gazebo": 4,
    "Needs Gazebo and PX4": 3,
    "Needs ROS 2": 2,
    "Needs a PX4": 4,
    "Needs a Ray cluster": 1,
    "Needs a Slurm cluster": 1,
    "Needs a database server": 1,
    "Needs a served vehicle": 1,
    "Needs an aircraft": 2,
    "Needs an elevation model": 1,
    "Needs a network": 1,
    "Needs jq": 1,
    "Runs until Ctrl-C": 2,
    "Set-up": 6,
    "Takes an hour": 4,
    "Takes half an hour": 3,
    "Takes hours": 4,
    "Takes minutes": 5,
    "Takes minutes to hours": 1,
}


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_blocks_say_what_they_are(page):
    for block in blocks(page):
        assert block.language in RUN | SHOWN, f"{page}:{block.line} has the language {block.language!r}"


def test_blocks_that_are_not_run_are_counted():
    titles = Counter(block.title for page in PAGES for block in blocks(page) if is_left_out(block))
    assert titles == NOT_RUN


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [page for page in PAGES if any(b.language in RUN for b in blocks(page))], ids=str
)
def test_blocks_run(page, tmp_path, monkeypatch):
    shutil.copytree(OWN_FILES, tmp_path, dirs_exist_ok=True)
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    names = {"__name__": "__main__"}
    for block in blocks(page):
        if is_left_out(block):
            continue
        where = f"{page}:{block.line}"
        if block.title:
            Path(block.title).write_text(block.text, "utf-8")
        if block.language == "bash":
            run_bash(block.text, where, tmp_path.with_name(f"{tmp_path.name}-bin"))
        elif block.language == "yaml":
            check_yaml(block.text)
        elif block.language == "python" and not block.title:
            exec(compile(block.text, where, "exec"), names)


def is_left_out(block: Block) -> bool:
    return block.language in RUN and block.title.startswith(("Needs", "Runs", "Set-up", "Takes"))


def run_bash(script: str, where: str, commands: Path) -> None:
    commands.mkdir(exist_ok=True)
    for name, call in (("skysweep", Path(__file__).with_name("quick.py")), ("python", "")):
        (commands / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {call} "$@"\n', "utf-8")
        (commands / name).chmod(0o755)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    environment = {
        **os.environ,
        "PAGE_PORT": port,
        "PATH": f"{commands}:{os.environ['PATH']}",
        "COLUMNS": "120",
    }
    ended = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert ended.returncode == 0, f"{where}\n{ended.stdout[-2000:]}\n{ended.stderr[-2000:]}"


def check_yaml(text: str) -> None:
    """A sweep, a scenario, or some of a scenario's fields."""
    content = yaml.safe_load(text)
    if "scenarios" in content:
        Path("sweep-of-the-page.yaml").write_text(text, "utf-8")
        load_spec("sweep-of-the-page.yaml")
        return
    around = (
        {}
        if "name" in content
        else {"name": "page", "area": {"polygon_enu_m": [[0, 0], [80, 0], [80, 80], [0, 80]]}}
    )
    Path("scenario-of-the-page.yaml").write_text(yaml.safe_dump({**around, **content}), "utf-8")
    ss.load_scenario("scenario-of-the-page.yaml")
