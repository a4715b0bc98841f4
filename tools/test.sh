#!/usr/bin/env bash
# Sets skysweep up for development and runs every check:  tools/test.sh
# With arguments pytest gets them, and what else takes long is left out (ROS, the wheel):
#   tools/test.sh tests/planning -x
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

tools/setup.sh dev train
export OMP_NUM_THREADS=1  # one core for each process
# On the second core beside the checks, so that not every process of the tests does it: a minute or two.
.venv/bin/python -c 'from skysweep.flights.rehearsal import compile_ahead; compile_ahead()' &
.venv/bin/python -m ruff check .
.venv/bin/python -m ruff format --check .
.venv/bin/python -m mypy
.venv/bin/lint-imports --no-logo --no-cache
.venv/bin/vermin --quiet --no-tips --target=3.10- --violations src tests tools examples
NO_MKDOCS_2_WARNING=1 .venv/bin/python -m mkdocs build --strict
wait $!
[ $# -eq 0 ] || exec .venv/bin/python -m pytest -n 2 "$@"

# ROS 2 has an environment of its own: its wheels restart Python and change where libraries are looked for.
ros_tests() {
    [ -e .venv-ros/bin/python ] || .venv/bin/python -m venv .venv-ros
    if .venv-ros/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[px4,ros,web]' hypothesis pytest; then
        .venv-ros/bin/python -m pytest tests/ros
    else
        echo "test: the wheels of ROS 2 could not be installed for $(.venv/bin/python --version): its tests are SKIPPED" >&2
    fi
}

passed=true
.venv/bin/python -m pytest -n 2 --durations=60 || passed=false
log=$(mktemp)
tools/try-wheel.sh >"$log" 2>&1 & # both take one core
ros_tests || passed=false
wait $! || passed=false
cat "$log"
rm "$log"
$passed
