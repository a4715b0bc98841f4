"""Who may see and control, which files can be read, and that no name is ever markup."""

import json

import pytest
from starlette.websockets import WebSocketDisconnect

from skysweep.scenarios.files import load_scenario, write_scenario
from skysweep.web.security import Access, is_loopback

OWN = "127.0.0.1:8765"
BEARER = {"authorization": "Bearer the-token"}
ORDER = {"word": "hold"}


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
def test_this_computer_may_see_without_a_token(client, host):
    assert client.get("/api/folder", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8765",
        "192.168.0.7:8765",
        "127.0.0.1.evil.example",
        "",
        "[",
        "[x]:1",
        "a]",
    ],
)
def test_another_name_that_leads_here_is_refused(client, host):
    answer = client.get("/api/folder", headers={"host": host})
    assert answer.status_code == 403
    assert "another" in answer.json()["error"]


def test_a_websocket_for_another_name_is_refused(client):
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("ws://evil.example/api/runs/short/follow"),
    ):
        pass


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "http://["])
def test_another_pages_request_is_refused(client, origin):
    assert client.get("/api/folder", headers={"origin": origin}).status_code == 403
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect(f"ws://{OWN}/api/runs/short/follow", headers={"origin": origin}),
    ):
        pass


def test_its_own_pages_websocket_is_let_in(client):
    origin = {"origin": "http://127.0.0.1:8765"}
    with client.websocket_connect(f"ws://{OWN}/api/runs/short/follow", headers=origin) as socket:
        assert socket.receive_json()["type"] == "lines"


def test_from_another_computer_nothing_is_seen_without_the_token(root, client_of):
    client = client_of(root, host="0.0.0.0", name="10.0.0.5:8765")
    for path in ("folder", "runs/short/scene", "runs/short/ground.jpg", "runs/short/report"):
        assert client.get(f"/api/{path}").status_code == 401
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("ws://10.0.0.5:8765/api/runs/short/follow"),
    ):
        pass
    assert client.get("/api/folder", headers={"authorization": "Bearer wrong"}).status_code == 401
    assert client.get("/api/folder", headers=BEARER).status_code == 200


def test_a_session_shows_pictures_and_the_websocket_but_does_not_control(root, client_of):
    given = []
    client = client_of(root / "short", "0.0.0.0", live="_", give=given.append, name="10.0.0.5:8765")
    assert client.post("/api/session", headers={"authorization": "Bearer wrong"}).status_code == 401
    answer = client.post("/api/session", headers=BEARER)
    assert answer.status_code == 200
    cookie = answer.headers["set-cookie"].lower()
    assert Access("0.0.0.0", "the-token").cookie in cookie
    assert Access("0.0.0.0", "another").cookie not in cookie
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert client.get("/api/folder").status_code == 200
    with client.websocket_connect("ws://10.0.0.5:8765/api/runs/_/follow") as socket:
        assert socket.receive_json()["type"] == "lines"
    assert client.post("/api/runs/_/operator", json=ORDER).status_code == 401
    assert given == []


def test_the_session_that_a_server_of_another_port_gets_orders_nothing(root, client_of):
    """Browsers send a cookie to every port of its host."""
    given = []
    client = client_of(root / "short", live="_", give=given.append)
    client.post("/api/session", headers=BEARER)
    (cookie,) = client.cookies.values()
    assert "the-token" not in cookie
    stolen = {"authorization": f"Bearer {cookie}"}
    assert client.post("/api/runs/_/operator", json=ORDER, headers=stolen).status_code == 401
    assert client.post("/api/session", headers=stolen).status_code == 401
    assert given == []


def test_controls_need_the_token_on_loopback_too(root, client_of):
    given = []
    client = client_of(root / "short", live="_", give=given.append)
    assert client.post("/api/runs/_/operator", json=ORDER).status_code == 401
    wrong = {"authorization": "Bearer the-tokem"}
    assert client.post("/api/runs/_/operator", json=ORDER, headers=wrong).status_code == 401
    assert given == []


def test_a_page_loads_nothing_from_elsewhere_but_the_tiles_that_were_given(root, client_of):
    policy = client_of(root).get("/api/folder").headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "unsafe-eval" not in policy
    assert "script-src 'self'; style-src 'self';" in policy
    tiles = client_of(root, tiles="https://tiles.example/{z}/{x}/{y}.png")
    policy = tiles.get("/api/folder").headers["content-security-policy"]
    assert policy.count("https://") == policy.count("https://tiles.example") == 2


@pytest.mark.parametrize(
    "path",
    [
        "runs/..%2Fsecret/scene",
        "runs/%2e%2e/secret/scene",
        "runs/short%2F..%2F..%2Fsecret/scene",
        "runs//etc/scene",
        "runs/%2Fetc/scene",
        "runs/short/film/..%2Fjournal.jsonl",
        "runs/short/film/..%2F..%2F..%2Fsecret%2Fconfig.yaml",
        "runs/short/pictures/..%2Fjournal.jsonl",
        "runs/short/pictures/..%2Fmap.png",
        "runs/short%00/scene",
        f"runs/{'x' * 5000}/scene",
    ],
)
def test_only_the_served_folder_can_be_read(client, root, path):
    secret = root.parent / "secret"
    secret.mkdir()
    (secret / "config.yaml").write_bytes((root / "short" / "config.yaml").read_bytes())
    (secret / "journal.jsonl").write_bytes((root / "short" / "journal.jsonl").read_bytes())
    answer = client.get(f"/api/{path}")
    assert answer.status_code == 404
    assert len(answer.content) < 300


def test_no_link_leads_out_of_the_served_folder(client, root):
    outside = root.parent / "outside"
    (root / "short").rename(outside)
    (root / "linked").symlink_to(outside)
    assert client.get("/api/runs/linked/scene").status_code == 404
    assert client.get("/api/folder").json()["entries"] == []
    (root / "short").mkdir()
    for name in ("config.yaml", "journal.jsonl"):
        (root / "short" / name).write_bytes((outside / name).read_bytes())
    (root / "short" / "report.html").symlink_to(outside / "report.html")
    (root / "short" / "film").symlink_to(outside / "film")
    film = next((outside / "film").iterdir()).name
    assert client.get("/api/runs/short/report").status_code == 404
    assert client.get(f"/api/runs/short/film/{film}").status_code == 404


def test_names_are_never_markup(run, client):
    """They come as JSON, which no browser reads as markup; the report is locked in."""
    scenario = load_scenario(run / "config.yaml")
    write_scenario(
        scenario.model_copy(update={"description": "<script>alert(1)</script>"}), run / "config.yaml"
    )
    (run / "journal.jsonl").unlink()
    scene = client.get("/api/runs/short/scene")
    assert scene.headers["content-type"] == "application/json"
    assert scene.headers["x-content-type-options"] == "nosniff"
    assert json.loads(scene.text)["description"] == "<script>alert(1)</script>"
    strange = client.get("/api/runs/<script>alert(1)</script>/scene")
    assert strange.status_code == 404
    assert strange.headers["content-type"] == "application/json"


def test_a_report_runs_no_script_and_is_of_no_origin(client):
    policy = client.get("/api/runs/short/report").headers["content-security-policy"]
    assert "sandbox" in policy.split("; ")
    assert "script-src" not in policy
    assert "default-src 'none'" in policy


def test_every_server_has_a_token_of_its_own():
    assert Access("127.0.0.1").token != Access("127.0.0.1").token
    assert len(Access("127.0.0.1").token) >= 32


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("127.8.0.1", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("", False),
    ],
)
def test_loopback_is_known(host, own):
    assert is_loopback(host) is own
