#!/usr/bin/env bash
# Builds wheel and sdist, looks into them, and uses the wheel in an empty environment outside the checkout:
#   tools/try-wheel.sh      after tools/setup.sh dev; a minute, most of it pip's
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

say() { printf 'try-wheel: %s\n' "$*"; }

checkout=$PWD
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

tools/web.sh
say "building"
.venv/bin/python -m build --outdir "$folder/by-sdist" . >"$folder/log" 2>&1 || { cat "$folder/log"; exit 1; }
.venv/bin/python -m build --wheel --outdir "$folder/direct" . >"$folder/log" 2>&1 || { cat "$folder/log"; exit 1; }
wheel=("$folder"/direct/*.whl)
cmp "$wheel" "$folder"/by-sdist/*.whl || { say "the sdist builds another wheel than the checkout" >&2; exit 1; }

# What git knows or would take, the built page, and the package's own notes: no more, no less.
package_files() { { git ls-files --cached --others --exclude-standard "$@"; find src/skysweep/web/static -type f; } | LC_ALL=C sort; }
diff <(package_files src/skysweep | grep -v '^src/skysweep/web/front/' | sed 's|^src/||') \
    <(.venv/bin/python -m zipfile -l "$wheel" | awk 'NR > 1 {print $1}' | grep -v '\.dist-info/' | LC_ALL=C sort) ||
    { say "the wheel holds other files than src/" >&2; exit 1; }
diff <({ package_files src/skysweep .gitignore CHANGELOG.md LICENSE README.md pyproject.toml; echo PKG-INFO; } | LC_ALL=C sort) \
    <(tar tf "$folder"/by-sdist/*.tar.gz | cut -d/ -f2- | LC_ALL=C sort) ||
    { say "the sdist holds other files than what builds the wheel" >&2; exit 1; }

say "installing $(basename "$wheel") in an empty environment"
.venv/bin/python -m venv "$folder/venv"
"$folder/venv/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check "$wheel"

cd "$folder"
unset PYTHONPATH
say "importing every module that needs no extra"
venv/bin/python - "$checkout" <<'PYTHON'
import pkgutil
import sys
from importlib import import_module
from pathlib import Path

import skysweep
from skysweep.errors import MissingExtraError

assert not Path(skysweep.__file__).is_relative_to(sys.argv[1]), f"{skysweep.__file__} is the checkout's"
for module in pkgutil.walk_packages(skysweep.__path__, "skysweep.", onerror=lambda _name: None):
    try:
        if not module.name.endswith("__main__"):
            import_module(module.name)
    except MissingExtraError:
        pass
    except ModuleNotFoundError as error:
        if error.name != "mavsdk":  # vehicles/px4/link.py says which extra brings it
            raise
PYTHON
say "flying a mission, writing its report"
venv/bin/skysweep run clusters --sensor statistical --out mission
rm mission/report.html
venv/bin/skysweep report mission
test -s mission/report.html
say "done: $(basename "$wheel") works by itself"
