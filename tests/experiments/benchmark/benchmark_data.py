"""A small suite: the real one with one family, few look-alikes and few seeds."""

from skysweep.experiments.benchmark.suite import Seeds, Suite, load_suite


def small_suite() -> Suite:
    suite = load_suite()
    seeds = Seeds(first=100, count=3, quick=2)
    pays = suite.break_even.model_copy(update={"counts": [0, 8], "prices_s": [10.0, 1000.0], "seeds": seeds})
    return suite.model_copy(update={"families": suite.families[:1], "seeds": seeds, "break_even": pays})
