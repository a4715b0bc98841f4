"""``python -m skysweep`` is the command line."""

from skysweep.cli import app

app(prog_name="skysweep")
