"""Environments for learning. ``import skysweep.gym`` registers ``skysweep/Search-v0`` with Gymnasium.

Importing it raises MissingExtraError if Gymnasium or PettingZoo is not installed.
"""

from __future__ import annotations

from skysweep.errors import MissingExtraError

try:
    import gymnasium
    import pettingzoo  # noqa: F401
except ImportError:
    raise MissingExtraError("skysweep.gym", "gym") from None

from skysweep.gym.env import SearchEnv
from skysweep.gym.parallel import SearchParallelEnv

__all__ = ["SearchEnv", "SearchParallelEnv"]

gymnasium.register(id="skysweep/Search-v0", entry_point="skysweep.gym.env:SearchEnv")
