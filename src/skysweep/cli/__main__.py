from skysweep.cli import app

app()
