"""See missions in a browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from skysweep.cli.common import friendly, say, tell
from skysweep.errors import UserError

HostOption = Annotated[
    str, typer.Option(help="Address to listen at. Others than this computer's own need the token to see.")
]
PortOption = Annotated[
    int | None, typer.Option(min=1, max=65535, help="Default: 8765, or the next free one.")
]
NoBrowserOption = Annotated[bool, typer.Option("--no-browser", help="Print the address only.")]
TilesOption = Annotated[
    str | None,
    typer.Option(help="Map tiles to load: https://HOST/{z}/{x}/{y}.png. Without it nothing is loaded."),
]


@friendly
def view(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Run folder, or a folder of runs, sweeps and comparisons.")
    ] = Path(),
    host: HostOption = "127.0.0.1",
    port: PortOption = None,
    no_browser: NoBrowserOption = False,
    tiles: TilesOption = None,
) -> None:
    """Show a mission in the browser: while it flies, or as a replay.

    Given a folder of runs, sweeps and comparisons, it lists them, newest first. The page is served on this
    computer until Ctrl-C; nothing is loaded from elsewhere unless --tiles is given.

    Examples:

        skysweep view runs/clusters-scan-check-seed0

        skysweep view

        skysweep view runs --host 0.0.0.0
    """
    from skysweep.web.security import Access
    from skysweep.web.server import address, listen, serve

    if not folder.is_dir():
        raise UserError(f"{folder}: is no folder; give a run folder, or a folder of runs")
    access = Access(host, tiles=checked_tiles(tiles))
    listener = listen(host, port)
    where = address(listener, access)
    tell(where)
    say("Ctrl-C ends it")
    serve(folder, listener, access, started=lambda: open_browser(where, no_browser))


def checked_tiles(tiles: str | None) -> str | None:
    """The address of map tiles. Raises UserError if it is none."""
    if tiles is None:
        return None
    placeholders = all(place in tiles for place in ("{z}", "{x}", "{y}"))
    if not tiles.startswith(("https://", "http://")) or not placeholders or any(c in tiles for c in " ;,'\""):
        raise UserError(f"--tiles {tiles}: write an address such as https://HOST/{{z}}/{{x}}/{{y}}.png")
    return tiles


def open_browser(where: str, no_browser: bool) -> None:
    """Open an address where there is a graphical browser."""
    if not no_browser and has_screen():
        webbrowser.open(where)


def has_screen() -> bool:
    """Whether a browser would have a window to appear in."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
