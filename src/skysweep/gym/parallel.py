"""A search by several vehicles as a PettingZoo parallel environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike
from pettingzoo import ParallelEnv

from skysweep.arrays import U8
from skysweep.errors import UserError
from skysweep.gym.env import PICTURES, checked
from skysweep.gym.picture import draw
from skysweep.gym.spaces import Observed, action_space, observation_space
from skysweep.gym.team import Rules, Team
from skysweep.scenarios.model import Scenario

Infos = dict[str, dict[str, Any]]


class SearchParallelEnv(ParallelEnv):  # type: ignore[misc]  # pettingzoo has no types
    """Several UAVs search the whole area of one scenario.

    Each has its own mission, sensor and candidates. They share the belief raster and know the others'
    positions. They start from the same home; nothing keeps them apart, and they do not collide. The arguments
    are those of ``SearchEnv`` and ``n``, the number of vehicles, at least 2.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "name": "skysweep_search_v0",
        "render_modes": list(PICTURES),
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: str | Scenario = "clusters",
        n: int = 2,
        render_mode: str | None = None,
        **rules: Any,
    ) -> None:
        if not (isinstance(n, (int, np.integer)) and n >= 2):
            raise UserError(
                f"n: is {n!r}; write an integer of at least 2, or take skysweep/Search-v0 for one vehicle"
            )
        self._team = Team(scenario, Rules.of(rules), n)
        self._rng = np.random.default_rng()
        self.render_mode = checked(render_mode)
        self.possible_agents = [f"uav_{k}" for k in range(n)]
        self.agents: list[str] = []
        cells, slots = self._team.rules.cells, self._team.rules.slots
        self.observation_spaces = {a: observation_space(cells, slots, n - 1) for a in self.possible_agents}
        self.action_spaces = {a: action_space() for a in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Dict:
        """The same object at every call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The same object at every call."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observed], Infos]:
        """All take off and begin the search."""
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self.agents = list(self.possible_agents)
        begun = dict(zip(self.agents, self._team.begin(self._rng, options), strict=True))
        return {a: r.observation for a, r in begun.items()}, {a: r.info for a, r in begun.items()}

    def step(
        self, actions: dict[str, ArrayLike]
    ) -> tuple[dict[str, Observed], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """All follow their actions for ``period_s``; a vehicle whose search has ended leaves ``agents``."""
        units = {self.possible_agents.index(a): actions[a] for a in self.agents}
        results = {self.possible_agents[k]: result for k, result in self._team.step(units).items()}
        self.agents = [a for a in self.agents if not (results[a].terminated or results[a].truncated)]
        return (
            {a: r.observation for a, r in results.items()},
            {a: r.reward for a, r in results.items()},
            {a: r.terminated for a, r in results.items()},
            {a: r.truncated for a, r in results.items()},
            {a: r.info for a, r in results.items()},
        )

    def render(self) -> U8 | None:
        """The map, north up, (H, W, 3)."""
        return draw(self._team) if self.render_mode is not None else None

    def close(self) -> None:
        """Release the missions."""
        self._team.close()
