"""The real Gazebo Classic 11. Where there is none its tests are skipped with the reason."""

from __future__ import annotations

import pytest

from skysweep.errors import UserError
from skysweep.gazebo.install import Install, find_install


@pytest.fixture(scope="session")
def gazebo() -> Install:
    try:
        return find_install()
    except UserError as error:
        pytest.skip(f"no test with the real Gazebo: {error}")
