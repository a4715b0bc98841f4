"""The script that flies PX4's Typhoon in Gazebo says what is missing."""

from __future__ import annotations

import subprocess
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "tools" / "px4-gazebo"


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(SCRIPT), *arguments], capture_output=True, text=True, check=False)


def test_without_arguments_it_says_how_it_is_used() -> None:
    done = _run()
    assert done.returncode == 2
    assert "tools/px4-gazebo PX4_FOLDER SCENARIO" in done.stderr


def test_changes_belong_into_the_scenario(tmp_path: Path) -> None:
    done = _run(str(tmp_path), "clusters", "--set", "camera.hfov_rad=2.0")
    assert done.returncode == 2
    assert "write the change into a scenario file" in done.stderr


def test_a_folder_that_is_no_px4(tmp_path: Path) -> None:
    done = _run(str(tmp_path), "clusters")
    assert done.returncode == 2
    assert f"{tmp_path}: is no PX4-Autopilot with Gazebo Classic" in done.stderr
