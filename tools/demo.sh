#!/usr/bin/env bash
# The first five minutes: sets skysweep up, flies one mission with pictures in each of the paper's scenarios, compares
# the strategies over 20 seeds without pictures, and writes one report:  tools/demo.sh [FOLDER]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

out=${1:-paper-run}

say() { printf '\n%s\n' "$*"; }

# fly SCENARIO N_C : a mission with pictures; in a browser while it flies, where there is a screen for one
fly() {
    local live=()
    if [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ] && .venv/bin/skysweep run --help | grep -q -- --live; then
        live=(--live)
    fi
    [ -e "$out/pictures/$1/summary.json" ] ||
        .venv/bin/skysweep run "$1" --n-c "$2" --d-c inf --out "$out/pictures/$1" ${live[@]+"${live[@]}"}
}

tools/setup.sh
began=$SECONDS
say "1 of 4: targets in two clusters, with pictures (4 steps: 3 to 4 minutes on two cores)"
fly clusters 5
say "2 of 4: targets all over the area, with pictures (the longest: a minute or two)"
fly abundance 1
say "3 of 4: few targets far apart, with pictures"
fly sparse inf
say "4 of 4: the paper's tables, scan-only and belief: 280 missions without pictures"
.venv/bin/skysweep compare paper --sensor statistical --seeds 20 --out "$out"
say "Done in $((SECONDS - began)) s. Open the report in a browser:  $PWD/$out/report.html"
