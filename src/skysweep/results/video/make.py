"""A video of a mission from its run folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

from skysweep.arrays import U8
from skysweep.errors import UserError
from skysweep.files.writing import whole_files
from skysweep.results.run_folder import Run
from skysweep.results.video.encode import encode, refuse_unwritable
from skysweep.results.video.page import SMALLEST_PX, Page
from skysweep.results.video.story import Story

_MOST_FRAMES = 200_000
_LARGEST_PX = (3840, 2160)


def write_video(
    run: Run,
    path: Path,
    speed: float = 10.0,
    size_px: tuple[int, int] = (1280, 720),
    fps: int = 15,
    on_frame: Callable[[int, int], None] = lambda done, of: None,
) -> Path:
    """Write an MP4, GIF or animated WebP, by the path's suffix, whole or not at all.

    The video plays ``speed`` times as fast as the mission flew. ``on_frame`` gets the frames done and their
    number. Raises UserError for a mission that has not begun, a size that is odd or too small, a path or
    ``fps`` that the format does not allow, and without a renderer.
    """
    refuse_unwritable(path, fps)
    for length, least, most in zip(size_px, SMALLEST_PX, _LARGEST_PX, strict=True):
        if length % 2 or not least <= length <= most:
            limits = " to ".join("x".join(map(str, limit)) for limit in (SMALLEST_PX, _LARGEST_PX))
            size = "x".join(map(str, size_px))
            raise UserError(f"--size {size}: write even numbers from {limits}, such as 1280x720")
    story = Story(run, speed, fps)
    if len(story) > _MOST_FRAMES:
        raise UserError(f"--speed {speed:g}: gives {len(story):,} frames, too many; write a greater speed")
    with whole_files(path.parent) as unfinished, closing(Page(story, *size_px)) as page:
        encode(_frames(story, page, on_frame), len(story), unfinished / path.name, fps, *size_px)
    return path


def _frames(story: Story, page: Page, on_frame: Callable[[int, int], None]) -> Iterator[U8]:
    for k in range(len(story)):
        yield page.draw(story.moment(k))
        on_frame(k + 1, len(story))
