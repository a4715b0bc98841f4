"""Strategies of a user's own code: named ``module:Name``, or handed in as objects.

Either is a class, or a function, that makes a strategy of a ``MissionContext``. Its attribute
``cover_altitude_agl_m``, a function of the search, says from which altitude the area is covered; without one
that is the scan altitude. Its attribute ``Parameters``, a pydantic model, says what ``search.parameters``
may hold.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Callable
from functools import partial, reduce
from pathlib import Path
from types import ModuleType
from typing import Any

from skysweep.errors import UserError
from skysweep.scenarios.model import Search
from skysweep.strategies.context import MissionContext
from skysweep.strategies.spec import MakeStrategy, NoParameters, StrategySpec, scan_altitude_agl_m
from skysweep.types import Command, Observation, Strategy

_METHODS = ("step", "snapshot", "restore")
_MAIN = "__main__"  # the module of notebooks and scripts


def is_given(name: str) -> bool:
    """Whether a strategy's name means a user's own code."""
    return ":" in name


def spec_named(name: str) -> StrategySpec:
    """The strategy that ``module:Name`` means; modules of the working folder are found, too.

    Raises UserError where there is no such module or name, importing it fails, or it makes no strategy.
    """
    where = f"search.strategy: {name}"
    module_name, _, attribute = name.partition(":")
    words = [*module_name.split("."), *attribute.split(".")]
    if not all(word.isidentifier() for word in words):
        if module_name == _MAIN or "<" in attribute:
            raise _not_importable(where)
        raise UserError(f"{where}: write MODULE:NAME, such as my_module:MyStrategy")
    module = _module(module_name, where)
    try:
        found: Any = reduce(getattr, attribute.split("."), module)
    except AttributeError:
        if module_name == _MAIN:
            raise _not_importable(where) from None
        place = getattr(module, "__file__", None) or module_name
        raise UserError(f"{where}: {place} has no '{attribute}'; check the name") from None
    return spec_of(found, where)


def spec_of(given: Any, where: str = "strategy") -> StrategySpec:
    """The strategy that an object makes; ``where`` begins the errors.

    Raises UserError where it is neither a class of strategies, nor a function that makes them, nor a spec.
    """
    if isinstance(given, StrategySpec):
        return given
    if isinstance(given, type):
        _refuse_lacking(given, given.__name__, where)
    elif hasattr(given, "step"):
        raise UserError(
            f"{where}: is one {type(given).__name__}, and each mission needs a fresh one; give the class, or "
            "a function of the MissionContext that makes one"
        )
    elif not callable(given):
        raise UserError(
            f"{where}: is {given!r:.60}; give a strategy's name, its class, or a function that makes one"
        )
    own = getattr(given, "cover_altitude_agl_m", None)
    cover: Callable[[Search], float] = own if callable(own) else scan_altitude_agl_m
    parameters = getattr(given, "Parameters", NoParameters)
    needs_model = bool(getattr(given, "needs_sensor_model", False))
    return StrategySpec(partial(_make, given, where), cover, parameters, needs_model)


def name_of(given: Any) -> str:
    """What run folders and tables call an object that makes strategies: ``module:Name``."""
    module = getattr(given, "__module__", None)
    name = getattr(given, "__qualname__", None)
    if isinstance(module, str) and isinstance(name, str):
        return f"{module}:{name}"
    return f"{_MAIN}:{type(given).__name__}"


def leads_back(given: Any, lasting: bool) -> bool:
    """Whether ``name_of`` the object leads back to it: in this process, or ``lasting``, in any other, too."""
    module_name, _, attribute = name_of(given).partition(":")
    module = sys.modules.get(module_name)
    if lasting and module_name == _MAIN and not hasattr(module, "__file__"):
        return False
    try:
        return bool(reduce(getattr, attribute.split("."), module) is given)
    except AttributeError:
        return False


def source_of(name: str) -> Path | None:
    """The file that a strategy's name leads to; None for built-in, installed and notebooks' ones."""
    if not is_given(name):
        return None
    module = sys.modules.get(name.partition(":")[0])
    file = getattr(module, "__file__", None)
    return Path(file) if file else None


def digest_of_source(name: str) -> str | None:
    """SHA-256 of that file, in hexadecimal."""
    path = source_of(name)
    return None if path is None else hashlib.sha256(path.read_bytes()).hexdigest()


class _Checked:
    """A strategy whose answers are looked at. Implements ``types.Strategy``."""

    def __init__(self, strategy: Strategy, where: str) -> None:
        self._strategy, self._where = strategy, where
        self.snapshot, self.restore = strategy.snapshot, strategy.restore

    def step(self, observation: Observation) -> Command:
        """What the strategy answers. Raises UserError where that is no command."""
        command = self._strategy.step(observation)
        if not isinstance(command, Command):
            raise UserError(
                f"{self._where}: step returned {command!r:.60}; return a Command(mode, waypoint, events)"
            )
        return command


def _make(given: MakeStrategy, where: str, context: MissionContext) -> Strategy:
    try:
        made = given(context)
    except UserError:
        raise
    except Exception as error:
        raise UserError(
            f"{where}: cannot be made of a MissionContext ({type(error).__name__}: {error}); mend it"
        ) from error
    _refuse_lacking(made, f"the {type(made).__name__} that it makes", where)
    return _Checked(made, where)


def _refuse_lacking(given: Any, what: str, where: str) -> None:
    missing = [name for name in _METHODS if not callable(getattr(given, name, None))]
    if missing:
        raise UserError(f"{where}: {what} has no {' and no '.join(missing)}; write what is missing")


def _module(name: str, where: str) -> ModuleType:
    if name in sys.modules:
        return sys.modules[name]
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)  # last, so that a file there hides nothing that is installed
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise UserError(f"{where}: importing {name} needs the module {error.name}; install it") from error
        raise UserError(
            f"{where}: there is no module '{name}' in {folder} or among the installed ones; go to its folder"
        ) from None
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"{where}: importing {name} raises {type(error).__name__}: {reason}; mend it"
        ) from error


def _not_importable(where: str) -> UserError:
    return UserError(
        f"{where}: was made in a notebook, a script or a function, and cannot be imported from elsewhere; "
        "put it at the top of a module of its own"
    )
