"""A search by one vehicle or several, as learners see it: decisions, rewards and its end."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from skysweep.arrays import F32
from skysweep.errors import UserError
from skysweep.gym.belief import Belief
from skysweep.gym.follower import AgentOrder
from skysweep.gym.sortie import Sortie
from skysweep.gym.spaces import Chart, Observed, as_numbers
from skysweep.mission.mission import Mission
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Scenario
from skysweep.types import Mode

_ENOUGH = 0.99  # covered share of the area at which a SCAN ends the search
_AHEAD_S = 2.0  # that a velocity's waypoint lies ahead of the end of its decision
_STILL = 1e-3  # of the scan speed


@dataclass(frozen=True, slots=True)
class Rules:
    """The rules of the environment. Raises UserError on a value that is out of range."""

    actions: Literal["velocity", "waypoint"] = "velocity"
    period_s: float = 0.4  # duration of a decision: one look at the usual rate
    time_limit_s: float = 1800.0  # of the mission, which is then called home
    cells: int = 64  # of the belief raster, along each side
    slots: int = 32  # for candidates
    cost_missed: float = 10.0  # of a target that is not found
    cost_false_alarm: float = 1.0  # of a confirmed candidate that is no target
    cost_second: float = 0.01  # of the search
    new_layouts: bool = True  # generators place their objects anew in every episode

    def __post_init__(self) -> None:
        if self.actions not in ("velocity", "waypoint"):
            raise UserError(f"actions: is {self.actions!r}; write velocity or waypoint")
        limits = {"period_s": 0.1, "time_limit_s": 1.0, "cells": 1, "slots": 1}
        for field in fields(self)[1:-1]:
            value, lowest = getattr(self, field.name), limits.get(field.name, 0.0)
            kind, what = (Integral, "an integer") if field.type == "int" else (Real, "a finite number")
            if not (isinstance(value, kind) and lowest <= float(value) < math.inf):
                raise UserError(f"{field.name}: is {value!r}; write {what} of at least {lowest:g}")

    @classmethod
    def of(cls, given: dict[str, Any]) -> Rules:
        """Rules from keyword arguments. Raises UserError on an unknown one."""
        names = [field.name for field in fields(cls)]
        unknown = next((name for name in given if name not in names), None)
        if unknown is not None:
            raise UserError(f"{unknown}: there is no such argument; write one of {', '.join(names)}")
        return cls(**given)


class Result(NamedTuple):
    """The outcome of one vehicle's decision."""

    observation: Observed
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]


class Team:
    """Vehicles that search one area, each in a mission of its own, with one belief raster."""

    def __init__(self, scenario: str | Scenario, rules: Rules, size: int) -> None:
        self._given, self.rules, self._size = scenario, rules, size
        self.sorties: list[Sortie] = []

    def begin(self, rng: np.random.Generator, options: dict[str, Any] | None) -> list[Result]:
        """Begin new missions at the scan altitude above home. Raises UserError if they cannot be flown."""
        self.close()
        scenario = _scenario_of((options or {}).get("scenario", self._given))
        if self.rules.new_layouts:
            anew = [g.model_copy(update={"seed": None}) for g in scenario.generators]
            scenario = scenario.model_copy(update={"generators": anew})
        self.scenario, self.chart = scenario, Chart.of(scenario)
        seed = int(rng.integers(2**31))
        for unit in range(self._size):
            self.sorties.append(Sortie(scenario, seed, self.chart, self._belief_of, unit))
        self._found: set[int] = set()  # targets
        self._false_alarms = [0] * self._size
        beginning = {"scenario": scenario.name, "bounds_enu_m": scenario.area_enu_m.bounds}
        return [
            Result(self._observe(k), 0.0, False, False, beginning | {"plan": sortie.plan} | _info(sortie))
            for k, sortie in enumerate(self.sorties)
        ]

    def step(self, actions: dict[int, ArrayLike]) -> dict[int, Result]:
        """Every vehicle that still searches follows its action, one after the other."""
        told = {k: self._fly(k, action) for k, action in actions.items()}
        return {k: Result(self._observe(k), *rest) for k, rest in told.items()}

    def close(self) -> None:
        """Release the missions."""
        for sortie in self.sorties:
            sortie.close()
        self.sorties = []

    def _belief_of(self, mission: Mission) -> Belief:
        if self.sorties:
            return self.sorties[0].belief
        return Belief(self.scenario, mission, self.chart, self.rules.cells)

    def _fly(self, unit: int, action: ArrayLike) -> tuple[float, bool, bool, dict[str, Any]]:
        sortie, rules = self.sorties[unit], self.rules
        n_before = sortie.n_confirmed
        searched_s = sortie.fly(self._order(sortie, action), rules.period_s, rules.time_limit_s)
        reward = -rules.cost_second * searched_s
        if sortie.n_confirmed > n_before:
            reward += self._score(unit)
        info = _info(sortie)
        if sortie.is_over:
            info |= {"summary": sortie.summary(), "found_by_all": len(self._found)}
        return reward, sortie.is_over and not sortie.was_called_home, sortie.was_called_home, info

    def _order(self, sortie: Sortie, action: ArrayLike) -> AgentOrder:
        east, north, check = np.clip(np.asarray(action, dtype=float), -1.0, 1.0).tolist()
        if not math.isfinite(east + north + check):
            raise ValueError(f"an action must be finite, not {np.asarray(action)}")
        mode = Mode.CHECK if check > 0.0 else Mode.SCAN
        speed_mps, ends = self.scenario.search.scan_speed_mps, sortie.belief.covered >= _ENOUGH
        if self.rules.actions == "waypoint":
            return AgentOrder(mode, self.chart.xy_enu_m(east, north), speed_mps, ends)
        x, y, _ = sortie.state.position_enu_m.tolist()
        share = math.hypot(east, north)
        if share < _STILL:
            return AgentOrder(mode, (x, y), speed_mps, ends)
        ahead_m = speed_mps * min(share, 1.0) * (self.rules.period_s + _AHEAD_S)
        place = x + ahead_m * east / share, y + ahead_m * north / share
        return AgentOrder(mode, place, speed_mps * min(share, 1.0), ends)

    def _score(self, unit: int) -> float:
        """The reward of new verdicts; a target counts only for the first vehicle that finds it."""
        matches = self.sorties[unit].matches()
        new = set(matches.confirmed.values()) - self._found
        false_alarms = len(matches.false_alarms) - self._false_alarms[unit]
        self._found |= new
        self._false_alarms[unit] += false_alarms
        return self.rules.cost_missed * len(new) - self.rules.cost_false_alarm * false_alarms

    def _observe(self, unit: int) -> Observed:
        told = self.sorties[unit].observe(self.rules.slots, self.rules.time_limit_s)
        if self._size > 1:
            told["others"] = self._others(unit)
        return told

    def _others(self, unit: int) -> F32:
        """The others' positions: east, north, and height relative to the scan altitude."""
        rows = []
        for k, sortie in enumerate(self.sorties):
            if k != unit:
                x, y, z = sortie.state.position_enu_m.tolist()
                height = z / self.scenario.search.scan_altitude_agl_m
                rows.append(as_numbers((*self.chart.on_square(x, y), height)))
        return np.array(rows)


def _info(sortie: Sortie) -> dict[str, Any]:
    return {"mode": str(sortie.mode), "time_s": sortie.state.time_s, "safety": sortie.alarms()}


def _scenario_of(given: object) -> Scenario:
    return given if isinstance(given, Scenario) else load_scenario(str(given))
