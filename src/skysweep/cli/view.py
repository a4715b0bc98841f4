"""See missions in a browser."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from skysweep.cli.common import friendly, say, tell
from skysweep.cli.live import (
    LOOPBACK,
    HostOption,
    NoBrowserOption,
    PortOption,
    TilesOption,
    checked_tiles,
    open_browser,
)
from skysweep.errors import UserError


@friendly
def view(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Run folder, or a folder of runs, sweeps and comparisons.")
    ] = Path(),
    host: HostOption = LOOPBACK,
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
    open_browser(where, no_browser)
    with suppress(KeyboardInterrupt):
        serve(folder, listener, access)
