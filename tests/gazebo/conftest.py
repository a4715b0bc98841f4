"""The real Gazebo Classic 11. Where there is none its tests are skipped with the reason; in CI they fail."""

from __future__ import annotations

import os

import pytest

from skysweep.errors import UserError
from skysweep.gazebo.install import Install, find_install


@pytest.fixture(scope="session")
def gazebo() -> Install:
    try:
        return find_install()
    except UserError as error:
        if os.environ.get("CI"):
            pytest.fail(f"CI tests with the real Gazebo; run tools/gazebo-root first ({error})")
        pytest.skip(f"no test with the real Gazebo: {error}")
