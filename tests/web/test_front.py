"""The page's pure parts: their own tests, and their types."""

import re
import shutil
import subprocess

import pytest

from skysweep.types import Mode
from skysweep.web.app import STATIC

FRONT = STATIC.parent / "front"


@pytest.mark.parametrize("script", ["check", "test"])
def test_the_front_end_passes_its_own_checks(script):
    npm = shutil.which("npm")
    if npm is None or not (FRONT / "node_modules").is_dir():
        pytest.skip("no npm, or tools/web.sh has not run: the page's own tests are NOT run")
    ran = subprocess.run([npm, "run", script], cwd=FRONT, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def test_the_page_knows_every_mode_of_a_mission():
    """One that it does not know would be shown as HOLD."""
    (words,) = re.findall(r"MODES = \[(.*)\]", (FRONT / "src" / "types.ts").read_text("utf-8"))
    assert set(re.findall(r'"(\w+)"', words)) == set(Mode)
