"""Policies without learning, for comparison, and their results."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from skysweep.arrays import F32
from skysweep.gym.env import SearchEnv
from skysweep.gym.spaces import OPEN, Observed
from skysweep.scenarios.model import Scenario
from skysweep.strategies.scan_check import SCAN_ACCEPTANCE_M

SCAN, CHECK = -1.0, 1.0
_TILL_CHECK = 5  # open candidates, as n_c
_POLICIES = (("velocity", ("random",)), ("waypoint", ("scan-only", "scan-check")))  # by their actions
N_POLICIES = sum(len(names) for _, names in _POLICIES)


class Policy(Protocol):
    """Chooses actions from observations."""

    def act(self, observation: Observed) -> F32:
        """The action."""


class Random:
    """A random action for every decision."""

    def __init__(self, env: SearchEnv, seed: int) -> None:
        self._space = env.action_space
        self._space.seed(seed)

    def act(self, observation: Observed) -> F32:
        """A random action."""
        return self._space.sample()


class PlannedPath:
    """Flies the planned path repeatedly; ``till_check`` open candidates, or the path's end, start a CHECK.

    Its actions are waypoints. After a CHECK it continues where it left the path, as Algorithm 1 does.
    """

    def __init__(self, info: dict[str, Any], till_check: float = math.inf) -> None:
        west, south, east, north = info["bounds_enu_m"]
        self._half_m = np.array([east - west, north - south]) / 2.0
        self._path, self._till_check = np.array(info["plan"]), till_check
        self._next, self._checks = 0, False
        self._left: F32 | None = None

    def act(self, observation: Observed) -> F32:
        """Towards the next waypoint, or down to a candidate."""
        place, up = observation["vehicle"][:2], observation["vehicle"][2] > 0.95
        candidates = observation["candidates"][observation["candidate_status"] == OPEN]
        ended = math.isfinite(self._till_check) and self._next >= len(self._path)
        self._checks = len(candidates) > 0 and (self._checks or ended or len(candidates) >= self._till_check)
        if self._checks:
            self._left = place.copy() if self._left is None else self._left
            return np.array([*candidates[0, :2], CHECK], dtype=np.float32)
        if self._left is not None and up and self._is_at(place, self._left):
            self._left = None
        if self._left is None and up and self._is_at(place, self._path[self._next % len(self._path)]):
            self._next += 1
        to = self._path[self._next % len(self._path)] if self._left is None else self._left
        return np.array([*to, SCAN], dtype=np.float32)

    def _is_at(self, place: F32, goal: Any) -> bool:
        return float(np.linalg.norm((place - goal) * self._half_m)) <= SCAN_ACCEPTANCE_M


@dataclass(frozen=True, slots=True)
class Played:
    """One episode, with the CPU time of its steps, which includes the flight home and the summary."""

    policy: str
    steps: int
    reward: float
    summary: dict[str, Any]
    cpu_s: float


def play_all(scenario: str | Scenario, seeds: Sequence[int], **rules: Any) -> Iterator[Played]:
    """Play an episode of each policy for each seed. Raises UserError as ``SearchEnv``."""
    for actions, names in _POLICIES:
        env = SearchEnv(scenario, actions=actions, **rules)
        env.reset(seed=0)
        env.step(np.zeros(3))  # compiles; that is not measured
        for name in names:
            for seed in seeds:
                yield _play(env, name, seed)
        env.close()


def _play(env: SearchEnv, name: str, seed: int) -> Played:
    observation, info = env.reset(seed=seed)
    policy: Policy
    if name == "random":
        policy = Random(env, seed)
    else:
        policy = PlannedPath(info, _TILL_CHECK if name == "scan-check" else math.inf)
    steps, total, cpu_s, over = 0, 0.0, 0.0, False
    while not over:
        action = policy.act(observation)
        began_s = time.process_time()
        observation, reward, terminated, truncated, info = env.step(action)
        cpu_s += time.process_time() - began_s
        steps, total, over = steps + 1, total + reward, terminated or truncated
    return Played(name, steps, total, info["summary"], cpu_s)
