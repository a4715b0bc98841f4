"""The server of a mission that flies: a process of its own that the mission never waits for."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import pytest
from websockets.sync.client import connect

from skysweep.errors import UserError
from skysweep.mission.journal import FileJournal, read_journal
from skysweep.mission.orders import Order
from skysweep.web.live import LivePage
from skysweep.web.security import Access
from skysweep.web.server import address, listen

SCENARIO = """\
name: short
area:
  polygon_enu_m: [[0, 0], [60, 0], [60, 40], [0, 40]]
home:
  position_enu_m: [-5, -5]
camera: {hfov_rad: 1.2}
targets:
  - {class: stop sign, position_enu_m: [20, 10], size_m: 0.9}
"""
SKYSWEEP = [sys.executable, "-m", "skysweep.cli"]


@pytest.fixture
def page(run, tmp_path):
    """The page of a mission that has begun, and its folder."""
    folder = tmp_path / "live"
    folder.mkdir()
    shutil.copy(run / "config.yaml", folder)
    (folder / "journal.jsonl").write_bytes((run / "journal.jsonl").read_bytes()[:20_000])
    made = LivePage(folder, Access("127.0.0.1"))
    yield made, folder
    made.close()


def asked(where, path, body=None):
    base, _, token = where.partition("/#token=")
    headers = {"authorization": f"Bearer {token}", "content-type": "application/json"}
    data = None if body is None else json.dumps(body).encode()
    with urllib.request.urlopen(urllib.request.Request(base + path, data, headers), timeout=60) as answer:
        return json.load(answer)


def follow(where, name="_", at=0):
    base = where.partition("/#token=")[0].replace("http", "ws")
    address = f"{base}/api/runs/{name}/follow?from={at}"
    return connect(address, max_size=None, open_timeout=60, close_timeout=0.1)


def printed_address(mission):
    """What a mission's command prints on standard error, where results are not."""
    return next(line for line in mission.stderr if line.startswith("http://")).strip()


def eventually(what, longest_s=30.0):
    until_s = time.monotonic() + longest_s
    while not what():
        assert time.monotonic() < until_s
        time.sleep(0.05)
    return True


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_an_order_on_the_page_reaches_the_mission(page):
    live, _ = page
    assert live.order() is None
    said = asked(live.address, "/api/runs/_/operator", {"word": "look", "position_enu_m": [4, 3]})
    assert "4 m east" in said["said"]
    got = []
    eventually(lambda: got.append(live.order()) or got[-1])
    assert got[-1] == Order("look", None, (4.0, 3.0))


def ordered(live, *given):
    """Give orders on the page, and wait until the mission's process has them."""
    for each in given:
        asked(live.address, "/api/runs/_/operator", each)
    eventually(lambda: len(live._steering) + len(live._others) == len(given))


def taken(live):
    """The words that the mission gets, tick by tick."""
    words = []
    while (order := live.order()) is not None:
        words.append(order.word)
    return words


def test_a_hold_does_not_wait_behind_verdicts(page):
    live, _ = page
    verdicts = [{"word": word, "candidate": k} for k in range(15) for word in ("confirm", "reject")]
    ordered(live, *verdicts, {"word": "hold"})
    assert live.order() == Order("hold")
    assert taken(live) == ["confirm", "reject"] * 15


def test_a_continue_that_was_said_before_a_hold_does_not_follow_it(page):
    live, _ = page
    ordered(live, *({"word": word} for word in ("continue", "hold", "continue", "return")))
    assert taken(live) == ["continue", "hold", "continue", "return"]


EVERY_ORDER = [
    {"word": "take back", "holder": "it is in Position"},
    {"word": "hold"},
    {"word": "continue"},
    {"word": "return"},
    {"word": "look", "position_enu_m": [4, 3]},
    {"word": "reject", "candidate": 3},
]


@pytest.fixture
def stood_still(monkeypatch):
    """A mission that waits as long as this stood still."""
    monkeypatch.setattr("skysweep.web.live._LATE_S", 0.2)
    return 0.3


def test_what_was_ordered_while_a_real_flight_stood_still_moves_it_only_home(
    run, tmp_path, stood_still, caplog
):
    setup, *_ = read_journal(run / "journal.jsonl")
    shutil.copytree(run, tmp_path / "real", ignore=shutil.ignore_patterns("journal.jsonl"))
    journal = FileJournal(tmp_path / "real" / "journal.jsonl")
    journal.write(
        0.0, "setup", **{k: v for k, v in setup.items() if k not in ("t", "kind")} | {"replays": False}
    )
    journal.close()
    live = LivePage(tmp_path / "real", Access("127.0.0.1"))
    try:
        ordered(live, *EVERY_ORDER)
        time.sleep(stood_still)
        assert taken(live) == ["hold", "return", "reject"]
        left_out = [record.getMessage() for record in caplog.records]
        assert [re.search("order to (.*) waited", said)[1] for said in left_out] == [
            "take back",
            "continue",
            "look",
        ]
        ordered(live, {"word": "continue"})
        assert taken(live) == ["continue"]
    finally:
        live.close()


def test_a_slow_simulated_mission_is_steered(page, stood_still):
    live, _ = page
    ordered(live, *EVERY_ORDER)
    time.sleep(stood_still)
    assert taken(live) == ["take back", "hold", "continue", "return", "look", "reject"]


def test_the_mission_knows_whether_the_server_is_there(page):
    live, _ = page
    asked(live.address, "/api/folder")
    assert live.is_there
    os.kill(live._server.pid, signal.SIGKILL)
    eventually(lambda: not live.is_there)
    assert live.order() is None


def test_a_page_opened_again_comes_back_to_the_present(page, run):
    live, folder = page
    with follow(live.address) as first:
        lines = json.loads(first.recv())["lines"]
    (folder / "journal.jsonl").write_bytes((run / "journal.jsonl").read_bytes())
    with follow(live.address) as second:
        message = json.loads(second.recv())
        assert message["from"] == 0
        assert len(message["lines"]) > len(lines)
        assert message["lines"][: len(lines)] == lines


def test_it_ends_with_its_mission(run, tmp_path):
    """Also with one that is killed."""
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom skysweep.web.live import LivePage\n"
        "from skysweep.web.security import Access\n"
        "page = LivePage(Path(sys.argv[1]), Access('127.0.0.1'))\n"
        "print(page.address, page._server.pid, flush=True)\ntime.sleep(600)\n"
    )
    mission = subprocess.Popen([sys.executable, "-c", code, str(run)], stdout=subprocess.PIPE, text=True)
    where, pid = mission.stdout.readline().split()
    assert asked(where, "/api/folder")["live"] == "_"
    mission.kill()
    mission.wait()
    mission.stdout.close()
    eventually(lambda: not alive(int(pid)))


def test_a_port_that_is_taken_is_one_sentence():
    taken = listen("127.0.0.1", None)
    port = taken.getsockname()[1]
    with pytest.raises(UserError, match=f"--port {port}: "):
        listen("127.0.0.1", port)
    other = listen("127.0.0.1", None)
    assert other.getsockname()[1] != port
    for each in (taken, other):
        each.close()


@pytest.mark.parametrize("host", ["a..b", "ä..b"])
def test_a_host_that_is_none_is_one_sentence(host):
    with pytest.raises(UserError, match=f"--host {re.escape(host)}: "):
        listen(host, None)


def test_the_token_is_where_no_log_sees_it():
    listener = listen("127.0.0.1", None)
    access = Access("127.0.0.1")
    before, _, fragment = address(listener, access).partition("#")
    listener.close()
    assert access.token not in before
    assert access.token in fragment


def test_a_mission_is_watched_held_continued_and_brought_home(tmp_path):
    """With nothing but what a browser does; the journal has every order."""
    (tmp_path / "short.yaml").write_text(SCENARIO)
    command = ["run", "short.yaml", "--sensor", "statistical", "--out", "out", "--live", "--no-browser"]
    mission = subprocess.Popen(
        [*SKYSWEEP, *command, "--speed", "4"],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    where = printed_address(mission)
    assert asked(where, "/api/runs/_/scene")["controls"]
    modes, kinds, orders = [], [], ["hold", "continue", "return"]
    with follow(where) as socket:
        ended = False
        while not ended:
            message = json.loads(socket.recv(timeout=60))
            for line in message.get("lines", ()):
                kinds.append(line["kind"])
                modes += [line["mode"]] if line["kind"] == "state" and [line["mode"]] != modes[-1:] else []
            due = {"hold": "SCAN", "continue": "HOLD", "return": "SCAN"}.get(orders[0]) if orders else None
            if modes and modes[-1] == due:
                asked(where, "/api/runs/_/operator", {"word": orders.pop(0)})
            ended = message.get("ended", False)
    output, errors = mission.communicate(timeout=180)
    assert mission.returncode == 0, errors
    assert "Mission time" in output
    words = [r["word"] for r in read_journal(tmp_path / "out" / "journal.jsonl") if r["kind"] == "operator"]
    assert words == ["hold", "continue", "return"]
    assert modes[:1] == ["TAKEOFF"]
    assert "HOLD" in modes
    assert modes[-2:] == ["RETURN", "LAND"]
    assert kinds[-1] == "end"


def test_ctrl_c_is_the_missions_and_ends_the_page_with_it(tmp_path):
    (tmp_path / "short.yaml").write_text(SCENARIO)
    command = [
        *SKYSWEEP,
        "run",
        "short.yaml",
        "--sensor",
        "statistical",
        "--out",
        "out",
        "--live",
        "--speed",
        "1",
    ]
    mission = subprocess.Popen(
        [*command, "--no-browser"],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    where = printed_address(mission)
    assert asked(where, "/api/runs/_/scene")["live"]
    os.killpg(mission.pid, signal.SIGINT)
    _, errors = mission.communicate(timeout=180)
    assert mission.returncode == 130
    assert "go on with:  skysweep resume out" in errors
    assert "Traceback" not in errors
    with pytest.raises(OSError):
        urllib.request.urlopen(where, timeout=5)


def test_the_page_stays_after_the_mission_where_somebody_sits_at_a_terminal(tmp_path):
    (tmp_path / "short.yaml").write_text(SCENARIO)
    command = ["run", "short.yaml", "--sensor", "statistical", "--out", "out", "--live", "--speed", "1000"]
    ours, terminal = os.openpty()
    mission = subprocess.Popen(
        [*SKYSWEEP, *command, "--no-browser"],
        cwd=tmp_path,
        stdin=terminal,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    where = printed_address(mission)
    eventually(lambda: (tmp_path / "out" / "report.html").exists(), 120.0)
    with follow(where) as socket:
        kinds = {line["kind"] for line in json.loads(socket.recv(timeout=60))["lines"]}
    assert "end" in kinds
    scene = asked(where, "/api/runs/_/scene")
    assert scene["targets"]
    assert not scene["controls"]
    assert mission.poll() is None
    mission.send_signal(signal.SIGINT)
    output, errors = mission.communicate(timeout=180)
    assert mission.returncode == 0
    assert "report: out/report.html" in output
    assert "the page stays until Ctrl-C" in errors
    os.close(ours)
    os.close(terminal)


def test_options_of_the_page_need_the_page(tmp_path):
    refused = subprocess.run(
        [*SKYSWEEP, "run", "clusters", "--host", "0.0.0.0"], cwd=tmp_path, capture_output=True, text=True
    )
    assert refused.returncode == 2
    assert "--host: is of the live page" in refused.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "tiles", ["ftp://x/{z}/{x}/{y}", "https://x/tiles", "https://x/{z}/{x}/{y}; script-src *"]
)
def test_what_is_no_address_of_tiles_is_refused(tmp_path, tiles):
    refused = subprocess.run(
        [*SKYSWEEP, "view", ".", "--tiles", tiles], cwd=tmp_path, capture_output=True, text=True
    )
    assert refused.returncode == 2
    assert "--tiles" in refused.stderr


def test_view_serves_a_folder_until_ctrl_c(root):
    viewer = subprocess.Popen(
        [*SKYSWEEP, "view", str(root), "--no-browser"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    where = viewer.stdout.readline().strip()
    assert [entry["id"] for entry in asked(where, "/api/folder")["entries"]] == ["short"]
    viewer.send_signal(signal.SIGINT)
    output, errors = viewer.communicate(timeout=30)
    assert viewer.returncode == 0
    assert errors == "Ctrl-C ends it\n"
    token = where.partition("token=")[2]
    assert token not in output + errors


def test_viewers_that_do_not_read_hold_up_nobody_and_nothing_is_kept_for_them(long_run):
    page = LivePage(long_run(3600), Access("127.0.0.1"))
    try:
        memory_mb = Path(f"/proc/{page._server.pid}/status")
        with ExitStack() as idle:
            asked(page.address, "/api/folder")
            for _ in range(9):
                idle.enter_context(follow(page.address))
            n, started = 0, time.monotonic()
            with follow(page.address) as quick:
                while True:
                    message = json.loads(quick.recv(timeout=30))
                    n += len(message.get("lines", ()))
                    if message["type"] == "status" and message["ended"]:
                        break
            assert n == 43_204
            assert time.monotonic() - started < 60
            peak = next(line for line in memory_mb.read_text().splitlines() if line.startswith("VmHWM"))
            assert int(peak.split()[1]) < 700_000
    finally:
        page.close()
