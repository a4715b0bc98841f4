"""The page's pure parts: their own tests, and their types."""

import shutil
import subprocess

import pytest

from skysweep.web.app import STATIC

FRONT = STATIC.parent / "front"


@pytest.mark.parametrize("script", ["check", "test"])
def test_the_front_end_passes_its_own_checks(script):
    npm = shutil.which("npm")
    if npm is None or not (FRONT / "node_modules").is_dir():
        pytest.skip("no npm, or tools/web.sh has not run: the page's own tests are NOT run")
    ran = subprocess.run([npm, "run", script], cwd=FRONT, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
