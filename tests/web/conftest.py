"""Missions to be shown, and a page's view of the server."""

import json
import shutil
import zlib
from itertools import cycle

import pytest
from starlette.testclient import TestClient

from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.mission.journal import read_journal
from skysweep.scenarios.model import Scenario
from skysweep.web.app import App
from skysweep.web.places import Places
from skysweep.web.security import Access

SHORT = {
    "name": "short",
    "area": {"polygon_enu_m": [[0, 0], [8, 0], [8, 6], [0, 6]]},
    "home": {"position_enu_m": [-12, -3]},
    "targets": [{"class": "stop sign", "position_enu_m": [4, 3], "size_m": 0.9}],
    "camera": {"hfov_rad": 1.2},
    "search": {"n_c": 1, "scan_altitude_agl_m": 8},
}


@pytest.fixture(scope="session")
def flown_once(tmp_path_factory):
    """The run folder of a mission with pictures, not to be changed."""
    folder = tmp_path_factory.mktemp("flown") / "short"
    fly_to_folder(Scenario.model_validate(SHORT), 0, folder, Rig(film=True))
    return folder


@pytest.fixture
def root(flown_once, tmp_path):
    """A folder with a run."""
    shutil.copytree(flown_once, tmp_path / "root" / "short")
    return tmp_path / "root"


@pytest.fixture
def run(root):
    return root / "short"


@pytest.fixture(autouse=True)
def cache(tmp_path_factory, monkeypatch):
    """A cache folder of the tests' own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def client_of():
    """Makes a client of a server of a folder; its address is that of loopback."""

    def make(root, host="127.0.0.1", live=None, give=None, tiles=None, name="127.0.0.1:8765"):
        access = Access(host, "the-token", tiles)
        app = App(Places(root), access, live, give).asgi()
        return TestClient(app, base_url=f"http://{name}", raise_server_exceptions=True)

    return make


@pytest.fixture
def client(root, client_of):
    return client_of(root)


@pytest.fixture
def long_run(run, tmp_path):
    """Makes a run folder whose journal has that many seconds of ten looks and two states each."""

    def make(duration_s):
        folder = tmp_path / f"lasts-{duration_s}-s"
        folder.mkdir()
        shutil.copy(run / "config.yaml", folder)
        records = read_journal(run / "journal.jsonl")
        states = cycle([r for r in records if r["kind"] == "state" and r["mode"] in ("SCAN", "CHECK")])
        looks = cycle([r for r in records if r["kind"] == "look"])
        whole = [r for r in records if r["kind"] in ("setup", "start", "plan")]
        for k in range(10 * duration_s):
            whole.append(next(looks) | {"t": k / 10})
            if k % 5 == 0:
                whole.append(next(states) | {"t": k / 10})
        whole.append({"t": float(duration_s), "kind": "end", "reason": "completed"})
        seal, lines = 0, []
        for text in map(json.dumps, whole):
            seal = zlib.crc32(text.encode(), seal)
            lines.append(f'{text[:-1]}, "chain": "{seal:08x}"}}\n')
        (folder / "journal.jsonl").write_text("".join(lines))
        return folder

    return make
