"""Make a video of a mission."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from skysweep.cli.common import counting, friendly, tell, warn
from skysweep.errors import UserError


@friendly
def video(
    folder: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="Run folder of a mission.")],
    out: Annotated[
        Path | None,
        typer.Option(help="File: .mp4, or .gif or .webp for an animation. Default: RUN_DIR/mission.mp4."),
    ] = None,
    speed: Annotated[
        float, typer.Option(min=0.1, max=1000.0, help="How many times as fast as the mission flew.")
    ] = 10.0,
    size: Annotated[str, typer.Option(metavar="WxH", help="Width and height in pixels.")] = "1280x720",
    fps: Annotated[int, typer.Option(min=1, max=60, help="Frames a second.")] = 15,
) -> None:
    """Make a video of a mission: 3-D view, map, the detector's view with its boxes, figures and events.

    Any mission with a run folder: simulated or real, with pictures or without, interrupted or still flying.
    The pictures are those of the detector's camera where the run folder has them (film/); otherwise they are
    rendered, and the caption says so.

    Examples:

        skysweep video runs/clusters-scan-check-seed0

        skysweep video my-run --out my-run.mp4 --speed 5 --fps 30 --size 1920x1080

        skysweep video my-run --out my-run.webp --speed 40 --fps 8 --size 640x360
    """
    from skysweep.results.run_folder import load_run
    from skysweep.results.video.make import write_video

    run = load_run(folder)
    if not run.ended:
        warn(f"{folder}: the mission was interrupted or is still flying; the video shows it so far")
    with counting("video") as on_frame:
        path = write_video(run, out or folder / "mission.mp4", speed, _size_of(size), fps, on_frame)
    tell(f"video: {path}")


def _size_of(text: str) -> tuple[int, int]:
    """Width and height in pixels of an option's WxH."""
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and len(text) < 12):
        raise UserError(f"--size {text}: is no size; write WIDTHxHEIGHT in pixels, such as 1280x720")
    return int(width), int(height)
