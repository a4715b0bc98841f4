#!/usr/bin/env bash
# Sets skysweep up, flies the paper's missions once each and writes the report:  tools/demo.sh
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

tools/setup.sh
.venv/bin/skysweep compare paper --seeds 1 --out paper-run
printf '\nOpen the report in a browser:  %s\n' "$PWD/paper-run/report.html"
