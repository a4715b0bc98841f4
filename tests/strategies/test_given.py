"""Strategies of a user's own code."""

import sys
from functools import partial

import pytest
from contexts import context_of

from skysweep.errors import UserError
from skysweep.scenarios.model import Search
from skysweep.strategies import strategy_spec
from skysweep.strategies.given import leads_back, name_of, spec_of

GOOD = """
class Own:
    def __init__(self, context):
        self.context = context

    def step(self, seen):
        return seen

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
            made.step("no command")


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


def test_a_name_leads_back_to_what_is_at_the_top_of_a_module(write):
    write("theirs_5", GOOD)
    strategy_spec("theirs_5:Own")
    own = sys.modules["theirs_5"].Own
    assert name_of(own) == "theirs_5:Own"
    assert leads_back(own, lasting=True)
    assert not leads_back(lambda *_: own, lasting=False)
    assert not leads_back(partial(own), lasting=False)
    assert spec_of(partial(own)).make(context_of()).snapshot() == {}
