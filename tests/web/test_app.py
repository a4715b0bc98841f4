"""The server's answers about a run."""

import cv2
import numpy as np
import pytest
from tests.web.conftest import SHORT

from skysweep.errors import UserError
from skysweep.flights.fly import fly_to_folder
from skysweep.flights.rig import Rig
from skysweep.geometry.camera import Lens
from skysweep.mission.journal import read_journal
from skysweep.mission.orders import Order
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.web.ground import ground_picture
from skysweep.web.orders import checked_order
from skysweep.web.scene import heights_of

BEARER = {"authorization": "Bearer the-token"}


def test_the_scene_says_all_that_the_map_needs(client):
    scene = client.get("/api/runs/short/scene").json()
    assert (scene["scenario"], scene["strategy"], scene["seed"]) == ("short", "scan-check", 0)
    assert scene["area_enu_m"] == [[0, 0], [8, 0], [8, 6], [0, 6]]
    assert scene["home_enu_m"] == [-12, -3]
    assert scene["camera"]["fx_px"] == pytest.approx(Lens(640, 360, 1.2).focal_px)
    assert scene["classes"] == ["stop sign"]
    assert scene["utm"] == {"zone": 34, "letter": "V"}
    assert scene["targets"] == [{"class_name": "stop sign", "position_enu_m": [4.0, 3.0, 0.0]}]
    assert scene["coverage"]["rows"] * scene["coverage"]["cell_m"] >= 6
    assert scene["simulated"]
    assert not scene["external"]
    assert not scene["live"]
    assert not scene["controls"]


def test_the_truth_is_kept_until_the_mission_has_ended(run, client):
    journal = run / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:20_000])
    assert client.get("/api/runs/short/scene").json()["targets"] == []


def test_the_ground_is_seen_from_above_north_up(client):
    scene = client.get("/api/runs/short/scene").json()
    answer = client.get(scene["ground"]["picture"])
    picture = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR)
    west, south, east, north = scene["bounds_enu_m"]
    assert picture.shape[1] / picture.shape[0] == pytest.approx((east - west) / (north - south), rel=0.01)
    assert picture.std() > 3
    assert client.get(scene["ground"]["picture"]).content == answer.content


def test_a_building_is_where_it_is_on_the_ground_picture(root, client):
    plain = load_scenario(root / "short" / "config.yaml")
    building = {"position_enu_m": [20, 30], "size_m": [12, 12], "height_m": 3}
    built = Scenario.model_validate(plain.model_dump(by_alias=True) | {"buildings": [building]})
    before, after = (
        cv2.imdecode(np.frombuffer(ground_picture(s, 0), np.uint8), cv2.IMREAD_COLOR).astype(int)
        for s in (plain, built)
    )
    changed = np.argwhere(np.abs(after - before).sum(axis=2) > 60)
    row, column = np.median(changed, axis=0)
    west, south, east, north = -72.0, -63.0, 68.0, 66.0
    x = west + column / before.shape[1] * (east - west)
    y = north - row / before.shape[0] * (north - south)
    assert (x, y) == (pytest.approx(20, abs=3), pytest.approx(30, abs=3))


def test_heights_are_the_terrains_from_the_south_west(run):
    scenario = load_scenario(run / "config.yaml")
    hills = Scenario.model_validate(
        scenario.model_dump(by_alias=True) | {"terrain": {"heightmap_m": [[0, 10], [20, 30]]}}
    )
    told = heights_of(hills)
    grid = np.array(told["heights_m"]).reshape(told["rows"], told["columns"])
    assert (grid[0, 0], grid[0, -1], grid[-1, 0], grid[-1, -1]) == (0, 10, 20, 30)


def test_pictures_of_the_film_and_of_candidates_are_served(run, client):
    film = sorted((run / "film").iterdir())[0]
    assert client.get(f"/api/runs/short/film/{film.name}").content == film.read_bytes()
    picture = next((run / "pictures").iterdir())
    assert client.get(f"/api/runs/short/pictures/{picture.name}").content == picture.read_bytes()
    assert client.get("/api/runs/short/film/1.jpg").status_code == 404


def test_a_run_folder_alone_is_served_as_itself(run, client_of):
    client = client_of(run)
    (entry,) = client.get("/api/folder").json()["entries"]
    assert entry["id"] == "_"
    assert client.get("/api/runs/_/scene").json()["scenario"] == "short"
    assert client.get("/api/runs/_/report").text.startswith("<!DOCTYPE html>")
    assert client.get(entry["thumbnail"]).headers["content-type"] == "image/png"


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        (lambda run: (run / "config.yaml").unlink(), "no config.yaml"),
        (
            lambda run: (run / "config.yaml").write_text("name: [", "utf-8"),
            "was changed after the mission began",
        ),
        (lambda run: (run / "journal.jsonl").write_text("{}"), None),
        (lambda run: (run / "journal.jsonl").unlink(), None),
    ],
)
def test_a_broken_folder_gives_one_sentence(run, client, broken, words):
    broken(run)
    answer = client.get("/api/runs/short/scene")
    if words is None:
        assert answer.status_code == 200
    else:
        assert answer.status_code == 404
        assert words in answer.json()["error"]
    assert client.get("/api/folder").status_code == 200


def test_what_the_system_refuses_is_one_sentence(run, client, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("skysweep.web.app.heights_of", refuse)
    answer = client.get("/api/runs/short/heights")
    assert answer.status_code == 500
    assert answer.json()["error"] == "The folder cannot be read (Permission denied)."


@pytest.mark.parametrize("given", ["abc", "-1", "1e3", "9" * 5000])
def test_a_line_to_begin_at_that_is_none_is_one_sentence(client, given):
    with client.websocket_connect(f"ws://127.0.0.1:8765/api/runs/short/follow?from={given}") as socket:
        assert socket.receive_json()["error"] == "from: is no line of a journal; write 0 or more."


def orders(root, client_of, *given):
    """What the mission gets, and the answers' codes."""
    got = []
    journal = root / "short" / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:20_000])
    client = client_of(root / "short", live="_", give=got.append)
    codes = [client.post("/api/runs/_/operator", json=each, headers=BEARER).status_code for each in given]
    return got, codes


def test_orders_reach_the_mission(root, client_of):
    got, codes = orders(
        root,
        client_of,
        {"word": "hold"},
        {"word": "continue"},
        {"word": "return"},
        {"word": "take back", "holder": "it is in Position: somebody chose that"},
        {"word": "reject", "candidate": 3},
        {"word": "confirm", "candidate": 0},
        {"word": "look", "position_enu_m": [4, -3.5]},
    )
    assert codes == [202] * 7
    assert got == [
        Order("hold"),
        Order("continue"),
        Order("return"),
        Order("take back", holder="it is in Position: somebody chose that"),
        Order("reject", 3),
        Order("confirm", 0),
        Order("look", None, (4.0, -3.5)),
    ]


@pytest.mark.parametrize(
    "given",
    [
        {"word": "hold"},
        {"word": "continue"},
        {"word": "return"},
        {"word": "take back", "holder": "a pilot"},
        {"word": "confirm", "candidate": 3},
        {"word": "look", "position_enu_m": [4, 3]},
    ],
)
def test_an_order_that_was_passed_on_is_not_called_done(given):
    assert " is asked to " in checked_order(given)[1]


@pytest.mark.parametrize("holder", [None, "", 3, ["a pilot"], "x" * 2001])
def test_the_vehicle_is_taken_back_from_somebody_only(holder):
    with pytest.raises(UserError, match=r"^holder: .*reload the page"):
        checked_order({"word": "take back", "holder": holder})


def test_what_is_no_order_is_refused(root, client_of):
    got, codes = orders(
        root,
        client_of,
        None,
        [],
        {"word": "land on me"},
        {"word": "reject"},
        {"word": "reject", "candidate": "3"},
        {"word": "reject", "candidate": True},
        {"word": "look", "position_enu_m": [1]},
        {"word": "look", "position_enu_m": [1, None]},
        {"word": "look", "position_enu_m": [1e300, 0]},
        {"word": "hold" * 2000},
        {"word": ["hold"]},
        {"word": {}},
        {"word": "look", "position_enu_m": [10**400, 0]},
        {"word": "take back"},
    )
    assert codes == [422] * 14
    assert got == []


@pytest.mark.parametrize(
    "body", [b"", b"\xff", b"[" * 4000, b'{"word": "look", "position_enu_m": [NaN, 1e999]}']
)
def test_what_is_no_json_is_refused(root, client_of, body):
    got = []
    (root / "short" / "journal.jsonl").write_bytes(b"")
    client = client_of(root / "short", live="_", give=got.append)
    assert client.post("/api/runs/_/operator", content=body, headers=BEARER).status_code == 422
    assert got == []


def test_a_flood_of_orders_does_not_pile_up_before_the_mission_and_leaves_room_to_hold(root, client_of):
    looks = [{"word": "look", "position_enu_m": [4, k]} for k in range(300)]
    got, codes = orders(root, client_of, *looks, {"word": "hold"})
    assert set(codes) == {202, 429}
    assert codes[-1] == 202
    assert len(got) <= 21
    assert got[-1].word == "hold"


def test_a_replay_and_a_mission_that_has_ended_take_no_orders(client, root, client_of):
    assert client.post("/api/runs/short/operator", json={"word": "hold"}, headers=BEARER).status_code == 409
    ended = client_of(root / "short", live="_", give=lambda order: None)
    assert ended.post("/api/runs/_/operator", json={"word": "hold"}, headers=BEARER).status_code == 409


def test_the_truth_of_a_target_that_moves_is_its_way_through_the_mission(tmp_path, client_of):
    walks = {"kind": "path", "waypoints_enu_m": [[8, 3]], "speed_mps": 0.1}
    target = {"class": "stop sign", "position_enu_m": [4, 3], "size_m": 0.9, "motion": walks}
    scenario = Scenario.model_validate({**SHORT, "targets": [target]})
    fly_to_folder(scenario, 0, tmp_path / "root" / "walk", Rig("statistical"))
    (shown,) = client_of(tmp_path / "root").get("/api/runs/walk/scene").json()["targets"]
    assert shown["position_enu_m"] == [4.0, 3.0, 0.0]
    way = np.array(shown["way"])
    assert way[0].tolist() == [0.0, 4.0, 3.0]
    assert way[-1, 0] == pytest.approx(read_journal(tmp_path / "root/walk/journal.jsonl")[-1]["t"], abs=0.01)
    np.testing.assert_allclose(way[:, 1], np.minimum(4.0 + 0.1 * way[:, 0], 8.0), atol=0.01)
