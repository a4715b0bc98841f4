"""What ``import skysweep`` offers, and nothing else of the package does: see docs/python.md."""
