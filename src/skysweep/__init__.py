"""skysweep plans, simulates, compares and flies UAV search-and-rescue missions."""

from skysweep.caching import prepare_numba_cache

__version__ = "0.1.0"

prepare_numba_cache()
