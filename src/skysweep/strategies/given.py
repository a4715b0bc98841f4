"""Strategies of a user's own code: named ``module:Name``, or handed in as objects.

Either is a class, or a function, that makes a strategy of a ``MissionContext``. Its attribute
``cover_altitude_agl_m``, a function of the search, says from which altitude the area is covered; without one
that is the scan altitude. Its attribute ``Parameters``, a pydantic model, says what ``search.parameters``
may hold. A function has these attributes itself: those of what it makes come too late.
"""

from __future__ import annotations

import hashlib
import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from pydantic import BaseModel

from skysweep.errors import UserError
from skysweep.scenarios.model import Search
from skysweep.strategies.checked import Checked, make_checked, refuse_lacking
from skysweep.strategies.context import MissionContext
from skysweep.strategies.spec import NoParameters, StrategySpec, scan_altitude_agl_m

_ATTRIBUTES = ("cover_altitude_agl_m", "Parameters", "needs_sensor_model")
_MAIN = "__main__"  # the module of notebooks and scripts
_imported: dict[str, tuple[object, str]] = {}  # by module: one import of it, and its file's SHA-256 then


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


def spec_of(given: Any, where: str = "") -> StrategySpec:
    """The strategy that an object makes, checked; ``where`` begins the errors.

    Raises UserError where it is neither a class of strategies, nor a function that makes them, nor a spec,
    or its attributes are not what they should be.
    """
    where, named = where or "strategy", where or f"strategy: {name_of(given)}"
    if isinstance(given, StrategySpec):
        _refuse_odd_parameters(given.parameters, where)
        return replace(given, make=partial(make_checked, given.make, where))
    if isinstance(given, type):
        refuse_lacking(given, given.__name__, where)
    elif hasattr(given, "step"):
        raise UserError(
            f"{where}: is one {type(given).__name__}, and each mission needs a fresh one; give the class, or "
            "a function of the MissionContext that makes one"
        )
    elif not callable(given):
        raise UserError(
            f"{where}: is {given!r:.60}; give a strategy's name, its class, or a function that makes one"
        )
    cover: Callable[[Search], float] = _told(given, "cover_altitude_agl_m", scan_altitude_agl_m)
    if not callable(cover):
        raise UserError(
            f"{named}: its cover_altitude_agl_m is {cover!r:.60}; make it a function of the search that "
            "returns metres above ground"
        )
    parameters = _told(given, "Parameters", NoParameters)
    _refuse_odd_parameters(parameters, named)
    needs_model = bool(_told(given, "needs_sensor_model", False))
    return StrategySpec(partial(_make_as_told, given, named), cover, parameters, needs_model)


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


def sources_of(name: str) -> tuple[Path, ...]:
    """The files of the code that a strategy's name leads to; none for built-in and notebooks' ones.

    That is the module, and those that it has a class with its bases, or a function, from, or their whole
    packages; ours and Python's own are left out. Raises UserError where one was changed since Python imported
    it.
    """
    module_name, _, attribute = name.partition(":")
    if not is_given(name) or module_name not in sys.modules:
        return ()
    found: Any = sys.modules[module_name]
    for word in attribute.split("."):
        found = getattr(found, word, None)
    modules = [m for m in dict.fromkeys([module_name, *_defined_in(found)]) if _is_foreign(m)]
    where = f"search.strategy: {name}"
    return tuple(dict.fromkeys(f for m in modules for f in _sound_sources(m, where)))


def _defined_in(found: Any) -> list[str]:
    """The modules of a class and its bases, or of a function."""
    while isinstance(found, partial | StrategySpec):
        found = found.func if isinstance(found, partial) else found.make
    if isinstance(found, type):
        return [kind.__module__ for kind in found.__mro__]
    return [str(found.__module__)] if isinstance(found, FunctionType) else []


def _is_foreign(module_name: str) -> bool:
    """Whether it was imported, and is neither ours nor Python's."""
    package = module_name.partition(".")[0]
    return module_name in sys.modules and package != "skysweep" and package not in sys.stdlib_module_names


def _sound_sources(module_name: str, where: str) -> tuple[Path, ...]:
    """The file of an imported module, or all files of its package. Raises UserError as ``sources_of``.

    Of a folder that is a package without saying so only what was imported is of it.
    """
    package = module_name.partition(".")[0]
    imported = [m for m in [*sys.modules] if m == package or m.startswith(f"{package}.")]
    files = [f for m in imported if (f := sound_source(m, where)) is not None]
    if getattr(sys.modules.get(package), "__file__", None) is None:
        return tuple(files)
    folders = getattr(sys.modules[package], "__path__", [])
    return tuple(sorted({*files, *(f for folder in folders for f in Path(folder).rglob("*.py"))}))


def sound_source(module_name: str, where: str) -> Path | None:
    """The file of an imported module; None where it has none. Raises UserError as ``sources_of``.

    What it held at the import is not known: that is what it holds when this is asked first.
    """
    module = sys.modules[module_name]
    file = getattr(module, "__file__", None)
    if not file:
        return None
    path, this = Path(file), getattr(module, "__spec__", None) or module  # another one after a reload
    now = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "deleted"
    at, then = _imported.get(module_name, (None, ""))
    if at is not this:
        _imported[module_name] = this, now
    elif then != now:
        raise UserError(f"{where}: {path} was changed since it was imported; restart Python to fly it")
    return path


def _told(given: Any, attribute: str, default: Any) -> Any:
    """An attribute of what makes strategies; a partial's is its function's."""
    while isinstance(given, partial) and not hasattr(given, attribute):
        given = given.func
    return getattr(given, attribute, default)


def _make_as_told(given: Callable[[MissionContext], Any], where: str, context: MissionContext) -> Checked:
    """A strategy. Raises UserError where it has an attribute that was not found in what makes it."""
    checked, missing = make_checked(given, where, context), object()
    for attribute in _ATTRIBUTES:
        if hasattr(checked.strategy, attribute) and _told(given, attribute, missing) is missing:
            kind = type(checked.strategy).__name__
            raise UserError(
                f"{where}: makes a {kind}, whose {attribute} would be ignored; give the class {kind}, or "
                "make it an attribute of what you give"
            )
    return checked


def _refuse_odd_parameters(given: Any, where: str) -> None:
    if not (isinstance(given, type) and issubclass(given, BaseModel)):
        raise UserError(
            f"{where}: its Parameters is {given!r:.60}; make it a class that inherits from pydantic.BaseModel"
        )


def _module(name: str, where: str) -> ModuleType:
    if name in sys.modules:
        sound_source(name, where)
        return sys.modules[name]
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.append(folder)  # last, so that a file there hides nothing that is installed
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise UserError(f"{where}: importing {name} needs the module {error.name}; install it") from error
        instead = "leave out .py" if name.endswith(".py") else "go to its folder"
        raise UserError(
            f"{where}: there is no module '{name}' in {folder} or among the installed ones; {instead}"
        ) from None
    except (Exception, SystemExit) as error:
        reason = " ".join(str(error).split())
        raise UserError(
            f"{where}: importing {name} raises {type(error).__name__}: {reason}; mend it"
        ) from error
    sound_source(name, where)
    return module


def _not_importable(where: str) -> UserError:
    return UserError(
        f"{where}: was made in a notebook, a script or a function, and cannot be imported from elsewhere; "
        "put it at the top of a module of its own"
    )
