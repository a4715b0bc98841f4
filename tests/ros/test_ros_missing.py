from __future__ import annotations

import sys

import pytest

from skysweep.errors import MissingExtraError
from skysweep.ros.support import load_rclpy


def test_without_ros_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "rpyutils", None)
    load_rclpy.cache_clear()
    with pytest.raises(MissingExtraError, match=r"install it with  tools/setup\.sh ros"):
        load_rclpy()
    load_rclpy.cache_clear()
