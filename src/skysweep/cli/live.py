"""The options of a mission with a live page, and the page."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skysweep.cli.common import say, warn
from skysweep.cli.terminal import has_keyboard
from skysweep.errors import UserError

if TYPE_CHECKING:
    from skysweep.mission.orders import Order
    from skysweep.web.live import LivePage

LOOPBACK = "127.0.0.1"
LIVE_SPEED = 10.0  # times real time, where no other is asked for


class PageOrders:
    """The orders given on a page, if there is one."""

    def __init__(self, page: LivePage | None = None) -> None:
        self._page, self._was_there = page, page is not None

    @property
    def can_come(self) -> bool:
        """Whether the page is there."""
        return self._page is not None and self._page.is_there

    def __call__(self) -> Order | None:
        if self._was_there and not self.can_come:
            self._was_there = False
            warn("the live page has ended; the mission goes on without it")
        return None if self._page is None else self._page.order()


LiveOption = Annotated[bool, typer.Option("--live", help="Show the mission in a browser while it flies.")]
SpeedOption = Annotated[
    float | None,
    typer.Option(min=0.1, help="Fly at most this many times as fast as real time. Default with --live: 10."),
]

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


@contextmanager
def live_page(
    folder: Path,
    live: bool,
    host: str,
    port: int | None,
    no_browser: bool,
    tiles: str | None,
) -> Iterator[PageOrders]:
    """The page of the mission in ``folder``, and the orders given on it; nothing unless ``live``.

    After the mission it stays until Ctrl-C where somebody sits at a terminal.
    """
    if not live:
        for option, given in (("--host", host != LOOPBACK), ("--port", port), ("--tiles", tiles)):
            if given:
                raise UserError(f"{option}: is of the live page; write --live, too, or leave it out")
        yield PageOrders()
        return
    from skysweep.web.live import LivePage
    from skysweep.web.security import Access

    page = LivePage(folder, Access(host, tiles=checked_tiles(tiles)), port)
    try:
        say(page.address)
        open_browser(page.address, no_browser)
        yield PageOrders(page)
        if has_keyboard():
            say("the page stays until Ctrl-C")
            with suppress(KeyboardInterrupt):
                page.wait()
    finally:
        page.close()


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
