"""Strategies of a user's own code."""

import importlib
import sys
from functools import partial

import pytest
from contexts import context_of, observed
from pydantic import BaseModel, field_validator, model_validator

from skysweep.errors import UserError
from skysweep.scenarios.files import load_scenario
from skysweep.scenarios.model import Search
from skysweep.strategies import code_of, fingerprint_of, strategy_spec
from skysweep.strategies.covering import as_covered
from skysweep.strategies.given import leads_back, name_of, spec_of
from skysweep.strategies.spec import StrategySpec

GOOD = """
class Own:
    def __init__(self, context):
        self.context = context

    def step(self, seen):
        return "no command"

    def snapshot(self):
        return {}

    def restore(self, snapshot):
        pass


class Poor:
    def snapshot(self): ...

    def restore(self, snapshot): ...


class Inside:
    Own = Own


made = Own(1)
number = 3
"""


@pytest.fixture
def write(tmp_path, monkeypatch):
    """Writes a module into the working folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    known = set(sys.modules)
    yield lambda name, text: (tmp_path / f"{name}.py").write_text(text)
    for name in set(sys.modules) - known:
        del sys.modules[name]


def test_a_module_of_the_working_folder_is_found(write):
    write("theirs_1", GOOD)
    for name in ("theirs_1:Own", "theirs_1:Inside.Own"):
        spec = strategy_spec(name)
        assert spec.cover_altitude_agl_m(Search(scan_altitude_agl_m=31.0)) == 31.0
        made = spec.make(context_of())
        with pytest.raises(UserError, match=r"step returned 'no command'; return a Command\(mode"):
            made.step(observed())


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("theirs_2:Owm", r"theirs_2:Owm: .*theirs_2\.py has no 'Owm'; check the name"),
        ("theirs_2:Poor", "Poor has no step; write what is missing"),
        ("theirs_2:made", "is one Own, and each mission needs a fresh one; give the class, or a function"),
        ("theirs_2:number", "is 3; give a strategy's name, its class, or a function"),
        ("theirs_2:", "write MODULE:NAME"),
        ("theirs-2:Own", "write MODULE:NAME"),
        (".theirs:Own", "write MODULE:NAME"),
        ("theirs_2.py:Own", "there is no module 'theirs_2.py' in .*; leave out .py"),
        ("nowhere_2:Own", "there is no module 'nowhere_2' in"),
        ("nowhere_2.inside:Own", "there is no module 'nowhere_2.inside' in"),
        ("broken_2:Own", r"importing broken_2 raises ZeroDivisionError: division by zero; mend it"),
        ("unwritten_2:Own", "importing unwritten_2 raises SyntaxError"),
        ("leaving_2:Own", "importing leaving_2 raises SystemExit"),
        ("needy_2:Own", "importing needy_2 needs the module not_there; install it"),
        ("__main__:Own", "was made in a notebook, a script or a function"),
        ("theirs_2:f.<locals>.Own", "was made in a notebook, a script or a function"),
    ],
)
def test_every_mistake_is_one_sentence(write, name, sentence):
    write("theirs_2", GOOD)
    write("broken_2", "1 / 0")
    write("unwritten_2", "class Own")
    write("leaving_2", "raise SystemExit(3)")
    write("needy_2", "import not_there")
    with pytest.raises(UserError, match=sentence):
        strategy_spec(name)


def test_what_a_class_refuses_is_one_sentence(write):
    write("theirs_3", GOOD + "\n\nclass Other(Own):\n    def __init__(self): ...\n")
    with pytest.raises(UserError, match=r"theirs_3:Other: cannot be made of a MissionContext \(TypeError"):
        strategy_spec("theirs_3:Other").make(context_of())
    write("theirs_4", "def make(context):\n    return 3\n")
    with pytest.raises(UserError, match="the int that it makes has no step and no snapshot and no restore"):
        strategy_spec("theirs_4:make").make(context_of())


TELLING = (
    GOOD
    + """
from pydantic import BaseModel


class Telling(Own):
    class Parameters(BaseModel):
        depth: int = 3

    needs_sensor_model = True

    @staticmethod
    def cover_altitude_agl_m(search):
        return 12.0


def make(context):
    return Telling(context)


class Late(Own):
    def __init__(self, context):
        self.cover_altitude_agl_m = lambda search: 12.0


def broken(context):
    raise ValueError("no way")
"""
)


def test_what_only_the_made_strategy_has_is_not_ignored(write):
    write("theirs_7", TELLING)
    for name, made in (("make", "Telling"), ("Late", "Late")):
        with pytest.raises(
            UserError,
            match=f"makes a {made}, whose cover_altitude_agl_m would be ignored; give the class {made}",
        ):
            strategy_spec(f"theirs_7:{name}").make(context_of())
    own = sys.modules["theirs_7"]
    own.make.cover_altitude_agl_m, own.make.Parameters = (
        own.Telling.cover_altitude_agl_m,
        own.Telling.Parameters,
    )
    with pytest.raises(UserError, match="whose needs_sensor_model would be ignored"):
        strategy_spec("theirs_7:make").make(context_of())
    own.make.needs_sensor_model = True
    for given in (own.make, own.Telling, partial(own.Telling), partial(partial(own.Telling))):
        spec = spec_of(given)
        assert spec.cover_altitude_agl_m(Search()) == 12.0
        assert (spec.parameters, spec.needs_sensor_model) == (own.Telling.Parameters, True)
        assert spec.make(context_of()).snapshot() == {}
    with pytest.raises(UserError, match=r"ValueError: no way at theirs_7\.py:"):
        strategy_spec("theirs_7:broken").make(context_of())


def test_a_name_leads_back_to_what_is_at_the_top_of_a_module(write):
    write("theirs_5", GOOD)
    strategy_spec("theirs_5:Own")
    own = sys.modules["theirs_5"].Own
    assert name_of(own) == "theirs_5:Own"
    assert leads_back(own, lasting=True)
    assert not leads_back(lambda *_: own, lasting=False)
    assert not leads_back(partial(own), lasting=False)
    assert spec_of(partial(own)).make(context_of()).snapshot() == {}


def test_a_module_that_changed_is_flown_after_a_restart_only(write):
    write("theirs_6", GOOD)
    strategy_spec("theirs_6:Own")
    fingerprint = fingerprint_of("theirs_6:Own")
    write("theirs_6", GOOD + "# another one\n")
    for ask in (strategy_spec, fingerprint_of, code_of):
        with pytest.raises(
            UserError, match=r"theirs_6\.py was changed since it was imported; restart Python"
        ):
            ask("theirs_6:Own")
    importlib.reload(sys.modules["theirs_6"])
    assert strategy_spec("theirs_6:Own")
    assert fingerprint_of("theirs_6:Own") != fingerprint


class Plain(BaseModel):
    share: float = 0.5


def named(attribute, value):
    """A strategy with an attribute, as it is handed in."""
    return spec_of(type("Own", (Whole,), {attribute: value}))


class Whole:
    def __init__(self, context): ...

    def step(self, seen): ...

    def snapshot(self):
        return {}

    def restore(self, snapshot): ...


class Inverse(BaseModel):
    share: float = 0.5
    depth: int

    @field_validator("share")
    @classmethod
    def inverse(cls, share):
        return 1 / share


def test_a_model_that_fails_is_one_sentence():
    with pytest.raises(UserError, match=r"^search\.parameters of .*: their model raises ZeroDivisionError"):
        named("Parameters", Inverse).parameters_of(Search(parameters={"share": 0.0, "depth": 3}))


def test_a_parameter_written_at_its_default_makes_no_other_search():
    spec = named("Parameters", Plain)
    assert spec.told_of(Search(parameters={"share": 0.5})) == spec.told_of(Search()) == {}
    assert spec.told_of(Search(parameters={"share": 0.25})) == {"share": 0.25}
    needs = named("Parameters", Inverse)
    assert needs.told_of(Search(parameters={"depth": 3})) == {"depth": 3}
    belief = strategy_spec("belief")
    both = {"alarm_cost_s": 400, "missed_cost_s": 400}
    assert belief.told_of(Search(strategy="belief", parameters=both)) == {"missed_cost_s": 400}


class Preset(BaseModel):
    preset: str = "slow"
    pause_s: float = 2.0

    @model_validator(mode="before")
    @classmethod
    def as_preset(cls, told):
        return {"pause_s": 0.5} | told if told.get("preset") == "fast" else told


def test_a_default_that_another_parameter_changes_is_told():
    spec = named("Parameters", Preset)
    both = {"preset": "fast", "pause_s": 2.0}
    assert spec.told_of(Search(parameters=both)) == both
    assert spec.told_of(Search(parameters={"preset": "fast"})) == {"preset": "fast"}


def test_parameters_that_are_none_of_a_plain_model_are_refused():
    spec = named("Parameters", Plain)
    assert spec.parameters_of(Search(parameters={"share": 0.25})).share == 0.25
    with pytest.raises(UserError, match="shar: there is no such field; write one of share"):
        spec.parameters_of(Search(parameters={"shar": 0.25}))


@pytest.mark.parametrize("given", [dict, Plain(), 3])
def test_parameters_are_a_pydantic_model(given):
    with pytest.raises(
        UserError, match=r"Own: its Parameters is .*; make it a class that inherits from pydan"
    ):
        named("Parameters", given)
    with pytest.raises(UserError, match="its Parameters is"):
        spec_of(StrategySpec(Whole, parameters=given))


SCENARIO = load_scenario("clusters")  # of 120 m at most


@pytest.mark.parametrize(
    ("cover", "sentence"),
    [
        (lambda _search: 400.0, r"returned 400; return 2 to 120 m, or change safety\.altitude_max_agl_m"),
        (lambda _search: 0.1, r"returned 0\.1; return 2 to 120 m"),
        (lambda _search: float("nan"), "returned nan; return 2 to 120 m"),
        (lambda _search: None, "returned None; return metres above ground"),
        (lambda _search: "30", "returned '30'; return metres above ground"),
        (lambda search: search.height, r"raises AttributeError: .*height.* at test_given\.py:\d+; make it a"),
        (lambda _self, _search: 30.0, r"raises TypeError: .*; make it a function of the search \(a staticm"),
    ],
)
def test_an_altitude_that_may_not_be_flown_is_refused(cover, sentence):
    spec = named("cover_altitude_agl_m", cover)
    with pytest.raises(UserError, match=f"scan-check: cover_altitude_agl_m {sentence}"):
        spec.cover_altitude_of(SCENARIO)


def test_an_altitude_is_a_function():
    with pytest.raises(UserError, match=r"Own: its cover_altitude_agl_m is 12\.0; make it a function"):
        named("cover_altitude_agl_m", 12.0)


def test_a_plan_covers_the_area_from_the_strategys_altitude():
    assert as_covered(SCENARIO) is SCENARIO
    low = SCENARIO.with_search(strategy="low-only")
    assert as_covered(low).search.scan_altitude_agl_m == low.search.check_altitude_agl_m
    with pytest.raises(UserError, match="there is no strategy 'nobody'"):
        as_covered(SCENARIO.with_search(strategy="nobody"))


def test_what_a_package_passes_on_is_code_of_its_own(write, tmp_path):
    """Also where the class is defined in another file than the one that is named."""
    (tmp_path / "theirs_7").mkdir()
    write("theirs_7/impl", GOOD)
    write("theirs_7/__init__", "from theirs_7.impl import Own\n")
    write("theirs_8", GOOD)
    write("theirs_9", "from theirs_8 import Own\n")
    for name, where in (("theirs_7:Own", "theirs_7/impl"), ("theirs_9:Own", "theirs_8")):
        strategy_spec(name)
        before = fingerprint_of(name)
        write(where, GOOD + "# another one\n")
        with pytest.raises(UserError, match=r"was changed since it was imported"):
            fingerprint_of(name)
        importlib.reload(sys.modules[where.replace("/", ".")])
        assert fingerprint_of(name) != before


@pytest.mark.parametrize(
    "passed_on",
    [
        "class Own(theirs.Own):\n    pass\n",
        "from functools import partial\nOwn = partial(theirs.Own)\n",
        "from skysweep.strategies.given import spec_of\nOwn = spec_of(theirs.Own)\n",
    ],
    ids=["a base", "a partial", "a spec"],
)
def test_what_a_strategy_is_made_of_elsewhere_is_its_code(write, tmp_path, passed_on):
    write("theirs_12", GOOD)
    write("theirs_13", f"import theirs_12 as theirs\n{passed_on}")
    try:
        strategy_spec("theirs_13:Own")
        files = {path.name for path in code_of("theirs_13:Own")[0]}
        assert files >= {"theirs_13.py"} | ({"theirs_12.py"} if "spec" not in passed_on else set())
    finally:
        for module in ("theirs_12", "theirs_13"):
            sys.modules.pop(module, None)


def test_of_a_plain_folder_only_what_is_imported_is_its_code(write, tmp_path):
    (tmp_path / "theirs_14").mkdir()
    write("theirs_14/mine", GOOD)
    write("theirs_14/plots", "")
    strategy_spec("theirs_14.mine:Own")
    assert [path.name for path in code_of("theirs_14.mine:Own")[0]] == ["mine.py"]


def test_what_is_passed_on_from_skysweep_is_no_code_of_theirs(write, tmp_path):
    write("theirs_10", "from skysweep.strategies.scan_check import ScanCheck as Own\n")
    write("theirs_11", "from skysweep.strategies import strategy_spec\nOwn = strategy_spec('scan-only')\n")
    for module in ("theirs_10", "theirs_11"):
        strategy_spec(f"{module}:Own")
        assert code_of(f"{module}:Own")[0] == (tmp_path / f"{module}.py",)
