"""The command that the pages' blocks call: skysweep, but without pictures and with few missions."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import yaml

from skysweep.cli import app
from skysweep.experiments.sweep.spec import load_spec

PORT = os.environ["PAGE_PORT"]  # a free one: other tests serve vehicles, too
STATISTICAL = {"--sensor": "statistical", "--speed": "1000"}
QUICK = {  # the first that fits; None: a flag
    "run valley": STATISTICAL | {"--set": "area.polygon_enu_m=[[300,300],[700,300],[700,600],[300,600]]"},
    "run": STATISTICAL,
    "video": {"--size": "320x180", "--fps": "2", "--speed": "40"},
    "tune": {"--trials": "1", "--seeds": "4", "--validation-seeds": "0", "--no-matters": None},
    "dataset": {"--images": "6"},
    "serve-vehicle": {"--port": PORT, "--local-port": "0"},
    "fly": {"--connection": f"udpin://127.0.0.1:{PORT}"},
}


def quick(arguments: list[str]) -> list[str]:
    """The arguments with the quick form's options; the last of two counts, and --set adds up."""
    if arguments[:1] == ["sweep"]:
        return ["sweep", _quick_sweep(Path(arguments[1])), *arguments[2:]]
    for command, options in QUICK.items():
        words = command.split()
        if arguments[: len(words)] == words and "--help" not in arguments:
            added = [
                word for option, value in options.items() for word in (option, value) if word is not None
            ]
            return [*arguments, *added]
    return arguments


def _quick_sweep(spec: Path) -> str:
    """One seed of the first two and of the last of its scenarios; all are checked."""
    load_spec(spec)
    content = yaml.safe_load(spec.read_text("utf-8"))
    scenarios = content["scenarios"]
    fewer = content | {"seeds": 1, "scenarios": [*scenarios[:2], *scenarios[2:][-1:]]}
    quicker = spec.with_name(f"quick-{spec.name}")
    quicker.write_text(yaml.safe_dump(fewer), "utf-8")
    return str(quicker)


if __name__ == "__main__":
    sys.argv[1:] = quick(sys.argv[1:])
    app(prog_name="skysweep")
