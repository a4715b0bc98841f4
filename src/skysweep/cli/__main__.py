"""``python -m skysweep.cli``: the command line."""

from skysweep.cli import app

app()
