"""The command that the pages' blocks call: skysweep, but without pictures and with few seeds."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import yaml

from skysweep.cli import app

PORT = os.environ["PAGE_PORT"]  # a free one: other tests serve vehicles, too
STATISTICAL = {"--sensor": "statistical", "--speed": "1000"}
QUICK = {  # the first that fits; None: a flag
    "run valley": STATISTICAL | {"--set": "area.polygon_enu_m=[[300,300],[700,300],[700,600],[300,600]]"},
    "run": STATISTICAL,
    "video": {"--size": "320x180", "--fps": "2", "--speed": "40"},
    "compare paper": {"--sensor": "statistical", "--seeds": "1", "--set": "camera.rate_hz=1"},
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
    content = yaml.safe_load(spec.read_text("utf-8")) | {"seeds": 1}
    with_one_seed = spec.with_name(f"quick-{spec.name}")
    with_one_seed.write_text(yaml.safe_dump(content), "utf-8")
    return str(with_one_seed)


if __name__ == "__main__":
    sys.argv[1:] = quick(sys.argv[1:])
    app(prog_name="skysweep")
