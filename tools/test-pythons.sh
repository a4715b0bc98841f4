#!/usr/bin/env bash
# Runs the quick tests on the oldest and the newest Python that we support, where this machine has them beside
# .venv's, each in an environment of its own (.venv-3.10, ...):  tools/test-pythons.sh [PYTEST ARGUMENT ...]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

QUICK=(tests/test_text.py tests/files tests/geometry tests/planning/test_coverage.py tests/scenarios tests/strategies/test_*.py
    tests/tracking tests/mission/test_loop.py)
NEEDED_BY_TESTS=(hypothesis pytest)

say() { printf 'test-pythons: %s\n' "$*"; }

# find_python VERSION : on the PATH or where pyenv and uv keep theirs
find_python() {
    local candidate
    for candidate in "python$1" ~/.pyenv/versions/"$1".*/bin/python ~/.local/share/uv/python/cpython-"$1".*/bin/python; do
        if "$candidate" -c 'import venv, ensurepip' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    return 1
}

version_of() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])'; }

# quick_tests VERSION PYTEST-ARGUMENT... : false where one fails
quick_tests() {
    local version=$1 environment=.venv-$1 python
    shift
    if ! python=$(find_python "$version"); then
        say "there is no Python $version on this machine: its tests are SKIPPED" >&2
        return
    fi
    [ -e "$environment/bin/python" ] || "$python" -m venv "$environment"
    say "installing skysweep for $("$environment/bin/python" --version)"
    "$environment/bin/python" -m pip install --quiet --disable-pip-version-check --editable '.[geo]' "${NEEDED_BY_TESTS[@]}" || return
    OMP_NUM_THREADS=1 "$environment/bin/python" -m pytest -m 'not slow and not exhaustive' "$@"
}

[ $# -gt 0 ] || set -- "${QUICK[@]}"
logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT
running=()
for version in 3.10 3.13; do
    [ "$version" = "$(version_of .venv/bin/python)" ] && continue
    quick_tests "$version" "$@" >"$logs/$version" 2>&1 & # one core each
    running+=("$!")
done
passed=true
for job in "${running[@]}"; do
    wait "$job" || passed=false
done
cat "$logs"/*
$passed
