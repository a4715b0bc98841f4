"""What the live page costs a mission, for ``skysweep bench``."""

from __future__ import annotations

import json
import multiprocessing
import statistics
import time
import urllib.request
from contextlib import ExitStack, suppress
from multiprocessing.synchronize import Event
from pathlib import Path
from tempfile import TemporaryDirectory

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.types import Detections, Mode, VehicleState
from skysweep.web.live import LivePage
from skysweep.web.security import Access

_SCENARIO, _STRATEGY = "clusters", "scan-only"  # rendered pictures and the detector, 143 s
_PAIRS = 5
_HOST = "127.0.0.1"
_OPENS_S = 120.0


def live_view_cost() -> float:
    """Share of a mission's speed that is lost while one page follows it, the median of ``_PAIRS`` pairs.

    Missions with pictures are flown as fast as they can, in turn alone and with a server and a page, which
    gets all lines and every new picture. Timed from take-off, with the page open.
    """
    with TemporaryDirectory(prefix="skysweep-") as name:
        folder = Path(name)
        _speed(folder / "warm-up", watched=False)
        shares = []
        for pair in range(_PAIRS):
            order = (False, True) if pair % 2 else (True, False)
            speeds = {watched: _speed(folder / f"{pair}-{watched}", watched) for watched in order}
            shares.append(1.0 - speeds[True] / speeds[False])
    return statistics.median(shares)


def _speed(folder: Path, watched: bool) -> float:
    """Mission seconds a second."""
    scenario = change_scenario(load_scenario(_SCENARIO), {"search.strategy": _STRATEGY})
    ticks: list[tuple[float, float]] = []

    def watch(state: VehicleState, _mode: Mode, _new: Detections | None) -> None:
        ticks.append((state.time_s, time.perf_counter()))

    with ExitStack() as stack:
        rig = Rig(film=True, watch=watch)
        if watched:
            page = LivePage(folder, Access(_HOST))
            stack.callback(page.close)
            rig = Rig(film=True, watch=watch, prepare=lambda _mission: _open(page.address, stack))
        fly_to_folder(scenario, 0, folder, rig)
    (first_s, started), (last_s, ended) = ticks[0], ticks[-1]
    return (last_s - first_s) / (ended - started)


def _open(address: str, stack: ExitStack) -> None:
    """Open a page, which follows the mission in a process of its own; return once it does."""
    spawn = multiprocessing.get_context("spawn")
    follows = spawn.Event()
    browser = spawn.Process(target=_follow, args=(address, follows), name="browser", daemon=True)
    browser.start()
    stack.callback(browser.join)
    stack.callback(browser.terminate)
    follows.wait(_OPENS_S)


def _follow(address: str, follows: Event) -> None:
    base = address.partition("/#")[0]
    run = f"{base}/api/runs/_"
    for path in ("scene", "heights", "ground.jpg"):
        urllib.request.urlopen(f"{run}/{path}").read()
    with (
        suppress(ConnectionClosed),
        connect(f"{run.replace('http', 'ws', 1)}/follow", max_size=None) as socket,
    ):
        while True:
            message = json.loads(socket.recv())
            follows.set()
            for time_s in message.get("times", ())[-1:]:
                urllib.request.urlopen(f"{run}/film/{time_s}.jpg").read()
