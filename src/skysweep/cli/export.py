"""What a mission found and searched, for the ground team's programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from skysweep.cli.common import friendly, say, tell, warn
from skysweep.errors import UserError

_UNFINISHED = "the mission was interrupted or is still flying; this is the state so far"


@friendly
def export(
    folder: Annotated[
        Path, typer.Argument(metavar="RUN_DIR", help="Run folder of a mission, which may still be flying.")
    ],
    form: Annotated[
        Literal["cot", "kmz", "gpx", "geojson", "kml", "csv", "geotiff", "coverage-geojson", "coverage-kml"],
        typer.Option(
            "--format",
            help="geotiff, coverage-...: the coverage as probability of detection. Others: targets.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Default: targets.kmz and so on, or coverage.tif and so on, in RUN_DIR."),
    ] = None,
    to: Annotated[
        str | None,
        typer.Option(metavar="udp://HOST:PORT", help="Send the events there instead; only --format cot."),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="With --to: send what is new until the mission has ended.")
    ] = False,
    ttl: Annotated[
        int, typer.Option(min=0, max=255, help="With --to a multicast group: how many networks it reaches.")
    ] = 1,
) -> None:
    """Write the targets or the coverage of a mission for another program, or send them to ATAK.

    Targets are the confirmed ones and those that were not checked. KMZ is for Google Earth and has their
    pictures inside; GPX for handheld receivers; GeoJSON for CalTopo and QGIS; CoT for ATAK and WinTAK.

    Examples:

        skysweep export runs/my-search --format kmz

        skysweep export runs/my-search --format cot --to udp://239.2.3.1:6969 --follow

        skysweep export runs/my-search --format geotiff --out coverage.tif
    """
    from skysweep.files.writing import replace_file
    from skysweep.results.export_formats import FORMATS
    from skysweep.results.run_folder import CONFIG_FILE, JOURNAL_FILE, SUMMARY_FILE, load_run

    if to is not None and (form != "cot" or out is not None):
        raise UserError("--to: sends Cursor-on-Target events; write --format cot, and leave --out out")
    if follow and to is None:
        raise UserError("--follow: needs an address to send to; write --to udp://HOST:PORT")
    if to is not None:
        _send(folder, to, follow, ttl)
        return
    run = load_run(folder)
    name, content = FORMATS[form]
    path = out or folder / name
    if path.name in (JOURNAL_FILE, CONFIG_FILE, SUMMARY_FILE):
        raise UserError(f"--out {path}: is what a run folder calls a file of its own; write another name")
    replace_file(path, content(run))
    if not run.ended:
        warn(f"{folder}: {_UNFINISHED}")
    tell(f"{form}: {path}")


def _send(folder: Path, address: str, follows: bool, ttl: int) -> None:
    from skysweep.results.run_folder import load_run
    from skysweep.results.sending import follow, send_once, udp

    run = load_run(folder)
    with udp(address, ttl) as send:
        if follows:
            say(f"sending to {address} until the mission has ended; Ctrl-C stops it")
            follow(folder, send, warn)
        else:
            if not run.ended:
                warn(f"{folder}: {_UNFINISHED}")
            tell(f"{send_once(run, send)} events sent to {address}")
