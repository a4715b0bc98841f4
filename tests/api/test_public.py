"""What ``import skysweep`` offers."""

import ast
import inspect
import subprocess
import sys
import typing
from pathlib import Path

import pytest

import skysweep as ss

HEAVY = (
    "numpy",
    "scipy",
    "numba",
    "matplotlib",
    "polars",
    "cv2",
    "onnxruntime",
    "pydantic",
    "shapely",
    "rich",
)
INIT = Path(ss.__file__)


def test_every_name_is_there_and_listed_once_more_for_type_checkers():
    tree = ast.parse(INIT.read_text())
    [typed] = [n for n in tree.body if isinstance(n, ast.If)]
    names = [(n.module, a.name, a.asname) for n in typed.body for a in n.names]
    assert sorted(name for _, name, _ in names) == ss.__all__
    for module, name, alias in names:
        assert name == alias
        assert getattr(ss, name) is getattr(sys.modules[module], name)
    assert (INIT.parent / "py.typed").is_file()


def test_a_name_that_is_not_public_is_not_there():
    with pytest.raises(AttributeError, match="has no attribute 'Multirotor'"):
        _ = ss.Multirotor


def test_importing_it_imports_nothing_heavy():
    code = f"import sys, skysweep; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def _functions(public):
    """A function itself; the public methods and properties of a class of ours."""
    if inspect.isfunction(public):
        yield public
    elif inspect.isclass(public):
        for name, member in vars(public).items():
            member = getattr(member, "fget", None) or getattr(member, "func", None) or member
            member = getattr(member, "__func__", member)
            if not name.startswith("_") and inspect.isfunction(member):
                yield member


@pytest.mark.parametrize("name", ss.__all__)
def test_every_public_thing_has_a_docstring_and_type_hints(name):
    public = getattr(ss, name)
    assert inspect.getdoc(public)
    for function in _functions(public):
        if function.__module__.startswith("skysweep"):
            where = f"{name}: {function.__qualname__}"
            hints = inspect.signature(function)
            assert hints.return_annotation is not inspect.Signature.empty, where
            assert all(
                p.annotation is not p.empty
                for p in hints.parameters.values()
                if p.name not in ("self", "cls")
            ), where
            if typing.get_origin(public) is None and not issubclass(type(public), type(typing.NamedTuple)):
                assert function.__doc__, where
