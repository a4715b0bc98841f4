"""What the belief strategy learns of how targets look here, and when it says so."""

import numpy as np
import pytest
from tests.strategies.belief.test_hypotheses import PLACE, above
from tests.strategies.contexts import context_of

import skysweep.flights.build as build
from skysweep.flights.rig import Rig
from skysweep.mission.journal import MemoryJournal
from skysweep.mission.loop import Flight
from skysweep.scenarios.files import change_scenario, load_scenario
from skysweep.sensing.statistical.model import model_for
from skysweep.strategies.belief.fit import Fit
from skysweep.strategies.belief.hypotheses import Hypotheses
from skysweep.strategies.belief.parameters import BeliefParameters
from skysweep.types import EventKind


def learned(told, likely=None):
    fit = Fit()
    fit.learn_shift(np.ones(len(told)) if likely is None else np.array(likely), np.array(told))
    return fit


def test_a_shift_is_learned_from_those_that_are_likely_targets_and_is_nothing_while_it_is_uncertain():
    eight = [(-8.0, 20.0)] * 8  # each says: 0.4 lower, give or take 0.22
    assert learned(eight).shift == pytest.approx(-0.4, abs=0.04)
    assert learned(eight, likely=[0.0] * 8).shift == 0.0
    assert learned(eight[:1]).shift == 0.0
    assert "0.4 lower than the sensor model says" in learned(eight).misfit()
    assert learned([(1.0, 20.0), (-1.0, 20.0)] * 4).misfit() == ""


@pytest.mark.parametrize("spread", [1.0, 1.4])
def test_the_spread_converges_to_that_of_the_scores(spread):
    fit, rng = Fit(), np.random.default_rng(3)
    for _ in range(4000):
        z = spread * rng.normal() / fit.widened
        fit.learn_spread(1.0, min(z * z, 9.0))
    assert fit.widened == pytest.approx(spread, rel=0.06)
    assert ("vary 1.4 times" in fit.misfit()) == (spread > 1.0)


def test_a_shift_weighs_as_another_mean_of_the_offset_would():
    """A target whose looks all score 0.4 low is likelier where all targets do."""
    signs = Hypotheses(context_of(), "stop sign", BeliefParameters())
    belief = signs.fresh()
    for _ in range(6):
        signs.look(belief, above(12.0), PLACE, 1.75, widened=1.0, others=0)
    usual, _, _, total, weight = signs.evidence(belief, np.zeros(3), 0.0)
    assert total < 0.0 < weight
    assert signs.evidence(belief, np.zeros(3), -0.3)[0] > usual > signs.evidence(belief, np.zeros(3), 0.3)[0]


@pytest.fixture
def worse_detector(monkeypatch):
    """The world's detector scores every target 0.4 lower than the strategy's model says."""

    def bent(scenario, *more, **named):
        model = model_for(scenario, *more, **named)
        kinds = [
            k.model_copy(update={"score": [x - 0.4 for x in k.score]}) if k.kind == k.reported_as else k
            for k in model.kinds
        ]
        return model.model_copy(update={"kinds": kinds})

    monkeypatch.setattr(build, "model_for", bent)


def flown(seed):
    scenario = change_scenario(load_scenario("abundance"), {"scatter_m": 5.0, "search.strategy": "belief"})
    journal = MemoryJournal()
    with Flight(build.build_mission(scenario, seed, Rig("statistical")), journal) as flight:
        for _ in flight:
            pass
    return journal.lines


def misfits(records):
    return [r["reason"] for r in records if r["kind"] == EventKind.MISFIT]


def test_a_model_that_fits_is_not_said_to_misfit():
    for seed in (9000, 9001):
        assert not misfits(flown(seed))


def test_a_detector_worse_than_its_model_is_noticed_and_its_targets_are_not_rejected(worse_detector):
    for seed in (9000, 9001):
        records = flown(seed)
        assert "lower than the sensor model says" in misfits(records)[-1]
        confirmed = [r for r in records if r["kind"] == EventKind.CONFIRMED]
        assert len(confirmed) >= 15  # of 16 targets
