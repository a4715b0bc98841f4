"""Which Gazebo is taken, and what is said where it is none."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from skysweep.errors import UserError
from skysweep.gazebo import install
from skysweep.gazebo.install import ROOT_VARIABLE, find_install


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """A machine without Gazebo."""
    monkeypatch.delenv(ROOT_VARIABLE, raising=False)
    monkeypatch.setattr(install, "DEFAULT_ROOT", tmp_path / "none")
    find_install.cache_clear()
    yield
    find_install.cache_clear()


def _program(folder: Path, name: str, says: str) -> None:
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\necho '{says}'\n")
    (folder / name).chmod(0o755)


def test_none_says_how_to_get_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install.shutil, "which", lambda name: None if name == "gzserver" else name)
    with pytest.raises(UserError, match=r"Gazebo Classic 11 is not here: install .* sudo tools/gazebo-root$"):
        find_install()


@pytest.mark.parametrize(
    ("says", "found"),
    [("Gazebo multi-robot simulator, version 9.0.0", "is 9,"), ("hello", "is another program,")],
)
def test_another_version(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, says: str, found: str) -> None:
    _program(tmp_path / "bin", "gzserver", says)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:/usr/bin:/bin")
    with pytest.raises(UserError, match=f"gzserver on the PATH {found} not Gazebo Classic 11"):
        find_install()


def test_unfinished_root(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(ROOT_VARIABLE, str(tmp_path))
    with pytest.raises(UserError, match="holds no complete Gazebo; run  sudo tools/gazebo-root"):
        find_install()


def test_named_root(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "opt/skysweep").mkdir(parents=True)
    (tmp_path / "opt/skysweep/libskysweep_gate-1.so").touch()
    (tmp_path / ".skysweep-ready").touch()
    monkeypatch.setenv(ROOT_VARIABLE, str(tmp_path))
    monkeypatch.setattr(install.os, "geteuid", lambda: 0)
    found = find_install()
    assert found.root == tmp_path
    assert found.plugin == Path("/opt/skysweep/libskysweep_gate-1.so")
