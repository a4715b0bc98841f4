"""Strategies of installed packages."""

import importlib
import shutil
import sys

import pytest
from contexts import context_of, observed

from skysweep.errors import UserError
from skysweep.experiments.matrix import Matrix
from skysweep.scenarios.files import load_scenario
from skysweep.strategies import fingerprint_of, strategy_names, strategy_spec
from skysweep.strategies.spec import StrategySpec

SCENARIO = load_scenario("clusters").with_search(strategy="spiral")


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Installs a package of this code and version that has the strategy ``spiral``."""
    monkeypatch.syspath_prepend(str(tmp_path))

    def installed(code, version="1.0"):
        for old in tmp_path.glob("*.dist-info"):
            shutil.rmtree(old)
        sys.modules.pop("spirals_code", None)
        folder = tmp_path / f"spirals-{version}.dist-info"
        folder.mkdir(exist_ok=True)
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: spirals\nVersion: {version}\n")
        (folder / "entry_points.txt").write_text("[skysweep.strategies]\nspiral = spirals_code:SPIRAL\n")
        (tmp_path / "spirals_code.py").write_text(code)
        importlib.invalidate_caches()

    return installed


GOOD = "from skysweep.strategies import strategy_spec\nSPIRAL = strategy_spec('scan-only')\n"


def key():
    return Matrix.of([("a", SCENARIO)], [0], "statistical", []).job(0).config_hash


def test_one_that_is_installed_is_found(install):
    install(GOOD)
    assert "spiral" in strategy_names()
    assert isinstance(strategy_spec("spiral"), StrategySpec)


def test_one_that_fails_to_load_is_one_sentence(install):
    install("1 / 0")
    with pytest.raises(UserError, match=r"spiral: spirals cannot be loaded \(ZeroDivisionError"):
        strategy_spec("spiral")


def test_one_that_ends_python_does_not_end_it_silently(install):
    install("raise SystemExit(3)")
    with pytest.raises(UserError, match=r"spiral: spirals cannot be loaded \(SystemExit: 3\)"):
        strategy_spec("spiral")


def test_its_missions_are_those_of_its_code_and_version(install):
    install(GOOD)
    first = key()
    assert key() == first
    install(GOOD + "# changed\n")
    second = key()
    install(GOOD, "1.1")
    assert len({first, second, key()}) == 3


def test_its_answers_are_looked_at(install):
    install(
        "from skysweep.strategies.spec import StrategySpec\n\n\n"
        "class Spiral:\n    def __init__(self, context): ...\n"
        "    def step(self, seen):\n        return 1 / 0\n"
        "    def snapshot(self):\n        return {}\n    def restore(self, snapshot): ...\n\n\n"
        "SPIRAL = StrategySpec(Spiral)\n"
    )
    made = strategy_spec("spiral").make(context_of())
    with pytest.raises(
        UserError, match=r"spiral: step raises ZeroDivisionError.* at spirals_code\.py:7; mend"
    ):
        made.step(observed())


def test_a_flight_is_gone_on_with_by_the_same_code_only(install):
    install(GOOD)
    first = fingerprint_of("spiral")
    assert first.startswith("spirals 1.0 ")
    install(GOOD + "# changed\n")
    second = fingerprint_of("spiral")
    install(GOOD, "1.1")
    assert len({first, second, fingerprint_of("spiral")}) == 3
    assert fingerprint_of("scan-only") is None
