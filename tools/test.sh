#!/usr/bin/env bash
# Sets skysweep up for development and runs every check:  tools/test.sh [pytest arguments]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

tools/setup.sh dev train
.venv/bin/python -m ruff check .
.venv/bin/python -m ruff format --check .
.venv/bin/python -m mypy
export OMP_NUM_THREADS=1  # one core for each of pytest's workers
exec .venv/bin/python -m pytest -n 2 "$@"
