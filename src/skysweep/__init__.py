"""skysweep plans, simulates, compares and flies UAV search-and-rescue missions."""

__version__ = "0.1.0"
