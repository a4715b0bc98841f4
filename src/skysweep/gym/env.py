"""``skysweep/Search-v0``: a search by one vehicle as a Gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
from numpy.typing import ArrayLike

from skysweep.arrays import F32, U8
from skysweep.errors import UserError
from skysweep.gym.picture import draw
from skysweep.gym.spaces import Observed, action_space, observation_space
from skysweep.gym.team import Rules, Team
from skysweep.scenarios.model import Scenario

PICTURES = ("rgb_array",)


class SearchEnv(gymnasium.Env[Observed, F32]):
    """One UAV searches a scenario's area with the statistical sensor; docs/gym.md has spaces and reward.

    ``scenario`` is a name, a path or a ``Scenario``; ``reset(options={"scenario": ...})`` changes it.
    ``rules`` are the fields of ``Rules``. Raises UserError if something is missing or cannot be flown.
    """

    metadata: dict[str, Any] = {"render_modes": list(PICTURES), "render_fps": 10}  # noqa: RUF012

    def __init__(
        self, scenario: str | Scenario = "clusters", render_mode: str | None = None, **rules: Any
    ) -> None:
        self._team = Team(scenario, Rules.of(rules), 1)
        self.render_mode = checked(render_mode)
        self.action_space = action_space()
        self.observation_space = observation_space(self._team.rules.cells, self._team.rules.slots)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Take off and begin the search. Every episode draws another mission seed."""
        unknown = next((name for name in options or () if name != "scenario"), None)
        if unknown is not None:
            raise UserError(f"options: there is no option {unknown!r}; write scenario")
        super().reset(seed=seed)
        begun = self._team.begin(self.np_random, options)[0]
        return begun.observation, begun.info

    def step(self, action: ArrayLike) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Do that for ``period_s``; if it ends the search, also fly home and land."""
        return self._team.step({0: action})[0]

    def render(self) -> U8 | None:
        """The map, north up, (H, W, 3)."""
        return draw(self._team) if self.render_mode is not None else None

    def close(self) -> None:
        """Release the mission."""
        self._team.close()


def checked(render_mode: str | None) -> str | None:
    """The render mode. Raises UserError if there is no such mode."""
    if render_mode not in (None, *PICTURES):
        raise UserError(f"render_mode: is {render_mode!r}; write {' or '.join(PICTURES)}, or leave it out")
    return render_mode
