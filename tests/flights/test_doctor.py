"""What is said of this machine."""

import json
import os
import socket
import subprocess
import sys
import threading

import pytest
from typer.testing import CliRunner

from skysweep import errors
from skysweep.cli import app
from skysweep.flights import doctor
from skysweep.flights.doctor import CHECKS, Finding, can_fly, examine


def by_name(name):
    return {finding.name: finding for finding in examine(name)}


@pytest.mark.parametrize("name", ["Python", "detector", "extras", "live page", "machine", "ROS 2"])
def test_a_check_says_what_it_found(name):
    findings = examine(name)
    assert findings
    for finding in findings:
        assert finding.said
        assert not finding.said.startswith("fails")
        assert finding.mend is None or finding.passed is not True


def test_the_detector_answers_a_picture():
    assert "answers a picture" in by_name("detector")["detector"].said


def test_extras_are_those_of_the_package_with_what_they_lack():
    found = by_name("extras")
    assert {"extra px4", "extra ros", "extra train"} <= set(found)
    assert found["extra px4"].passed is True
    for finding in found.values():
        assert finding.passed or finding.mend == errors.install_command(finding.name.removeprefix("extra "))


def test_without_a_clone_pip_mends(monkeypatch, tmp_path):
    assert errors.install_command("px4") == "tools/setup.sh px4"
    monkeypatch.setattr(errors, "CLONE", tmp_path)
    assert errors.install_command("px4") == "pip install 'skysweep[px4]'"


@pytest.fixture
def px4_port(monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr(doctor, "PX4_PORT", port)
    return port


def test_a_vehicle_that_sends_is_heard(px4_port):
    stop = threading.Event()

    def send():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
            while not stop.wait(0.05):
                vehicle.sendto(b"heartbeat", ("127.0.0.1", px4_port))

    sender = threading.Thread(target=send)
    sender.start()
    try:
        found = by_name("PX4")["PX4 port"]
    finally:
        stop.set()
        sender.join()
    assert found.passed is True
    assert "127.0.0.1" in found.said


def test_a_silent_and_a_taken_port_are_told_apart(px4_port):
    silent = by_name("PX4")["PX4 port"]
    assert (silent.passed, silent.mend) == (None, "skysweep serve-vehicle")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", px4_port))
        taken = by_name("PX4")["PX4 port"]
    assert taken.passed is None
    assert "another program" in taken.said


def test_where_opengl_does_not_start_embree_is_enough():
    pytest.importorskip("embreex")
    code = (
        "from skysweep.flights.doctor import can_fly, examine\n"
        "found = examine('cameras')\n"
        "assert (found[0].name, found[0].passed) == ('OpenGL', None), found\n"
        "assert found[0].mend.startswith('apt-get install'), found\n"
        "assert can_fly(found)\n"
    )
    without_drivers = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json"}
    subprocess.run([sys.executable, "-c", code], env=os.environ | without_drivers, check=True)


def test_a_check_that_breaks_is_a_finding(monkeypatch):
    def broken():
        raise RuntimeError("a driver\nthat breaks")

    monkeypatch.setitem(CHECKS, "detector", broken)
    monkeypatch.setitem(CHECKS, "ROS 2", broken)
    assert examine("detector") == [Finding("detector", False, "fails: a driver that breaks")]
    assert examine("ROS 2") == [Finding("ROS 2", None, "fails: a driver that breaks")]
    assert not can_fly(examine("detector"))
    assert can_fly(examine("ROS 2"))


@pytest.mark.parametrize(("least_gb", "code"), [(0.0, 0), (1e9, 1)])
def test_the_exit_code_says_whether_a_mission_can_be_flown(monkeypatch, least_gb, code):
    """With the checks that are fast and the same everywhere."""
    monkeypatch.setattr(doctor, "_LEAST_FREE_GB", least_gb)
    for name in set(CHECKS) - {"Python", "machine"}:
        monkeypatch.delitem(CHECKS, name)
    result = CliRunner().invoke(app, ["doctor", "--json"])
    assert result.exit_code == code
    told = json.loads(result.stdout)
    assert told["can_fly"] == (code == 0)
    assert {"name", "passed", "said", "mend"} == set(told["checks"][0])
    shown = CliRunner().invoke(app, ["doctor"])
    assert shown.exit_code == code
    assert "cores" in shown.stdout
