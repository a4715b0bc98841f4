"""Missions to be shown, and a page's view of the server."""

import shutil

import pytest
from starlette.testclient import TestClient

from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
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
