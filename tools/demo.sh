#!/usr/bin/env bash
# The first minutes:  tools/demo.sh [FOLDER]
# Sets skysweep up, flies one mission with pictures in each of the paper's scenarios, compares the strategies over 20 seeds
# without pictures, and writes one report. Run it again, and it continues where it was stopped.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=${1:-paper-run}
skysweep=.venv/bin/skysweep

say() { printf '\n%s\n' "$*"; }

compare=("$skysweep" compare paper --sensor statistical --seeds 20 --out "$out")

has_screen() { [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ]; }

# fly SCENARIO N_C : with pictures; on the live page, where there is a screen for it
fly() {
    local live=()
    ! has_screen || [ ! -e src/skysweep/web/static/index.html ] || live=(--live)
    [ ! -e "$out/pictures/$1/summary.json" ] || { echo "flown before"; return 0; }
    rm -rf "${out:?}/pictures/$1"
    # Without a terminal as input the live page does not wait for anybody.
    "$skysweep" run "$1" --n-c "$2" --d-c inf --out "$out/pictures/$1" ${live[@]+"${live[@]}"} </dev/null
}

if has_screen; then tools/setup.sh web; else tools/setup.sh; fi
say "Three missions with pictures, and 280 without beside them on the other core: 3 to 10 minutes on two cores."
began=$SECONDS
mkdir -p "$out"
"${compare[@]}" --workers 1 >"$out/compare.log" 2>&1 &
beside=$!
trap 'kill $beside 2>/dev/null || true' EXIT
say "1 of 4: targets in two clusters (1 to 2 minutes)"
fly clusters 5
say "2 of 4: targets all over the area (2 to 5 minutes)"
fly abundance 1
say "3 of 4: few targets, far apart (1 to 2 minutes)"
fly sparse inf
say "4 of 4: the paper's tables, with scan-only and belief beside them"
kill $beside 2>/dev/null || true # what it has flown stays; the rest is flown on both cores, where it can be watched
wait $beside 2>/dev/null || true
"${compare[@]}"
say "Done in $((SECONDS - began)) s. Open the report in a browser:  $(realpath "$out")/report.html"
