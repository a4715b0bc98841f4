#!/usr/bin/env bash
# Sets skysweep up in .venv on Debian or Ubuntu, as root or with sudo:  tools/setup.sh [EXTRA ...]
# Extras are those of pyproject.toml (px4, ros, ray, tune, ...), dev, and train, which brings PyTorch and YOLOX.
# Run it as often as you like: what is there stays, what is missing is added.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

TORCH="torch==2.13.0"
# YOLOX without its full list of requirements: torchvision serves for NMS alone, which skysweep brings.
YOLOX="pixeltable-yolox==0.4.3"
YOLOX_NEEDS=(loguru packaging pillow psutil pycocotools tabulate tqdm)
PYTHON_NEEDS=(python3 python3-venv)
PICTURE_NEEDS=(libegl1 libgl1 libgl1-mesa-dri)

say() { printf 'setup: %s\n' "$*"; }

# as_root COMMAND... : runs it; asks for a password where someone can answer
as_root() { if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo "$@"; fi; }

may_be_root() {
    [ "$(id -u)" -eq 0 ] || { command -v sudo >/dev/null && { [ -t 0 ] || sudo -n true 2>/dev/null; }; }
}

# apt_install PACKAGE... : fails, and says nothing, where that cannot be done
apt_install() {
    command -v apt-get >/dev/null && may_be_root || return 1
    say "installing $*"
    local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=120)
    as_root "${apt[@]}" update >/dev/null 2>&1 || true
    as_root "${apt[@]}" install -y --no-install-recommends "$@" >/dev/null 2>&1
}

missing_packages() {
    local package
    for package in "$@"; do
        dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null | grep -qx installed || echo "$package"
    done
}

can_make_venv() { "$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 10))' 2>/dev/null; }

find_python() {
    local candidate
    for candidate in python3 /usr/bin/python3 python3.14 python3.13 python3.12 python3.11 python3.10; do
        if can_make_venv "$candidate"; then
            echo "$candidate"
            return
        fi
    done
    return 1
}

make_venv() {
    .venv/bin/python -m pip --version >/dev/null 2>&1 && return
    local python
    if ! python=$(find_python); then
        apt_install "${PYTHON_NEEDS[@]}" || true
        python=$(find_python) || {
            say "needs Python 3.10 or later with venv; install it with  apt-get install ${PYTHON_NEEDS[*]}" >&2
            exit 1
        }
    fi
    say "making .venv with $("$python" --version)"
    "$python" -m venv --clear .venv
}

pip_install() { .venv/bin/python -m pip install --quiet --disable-pip-version-check "$@"; }

install_package() {
    local extras=() wants_train=false extra
    for extra in "$@"; do
        if [ "$extra" = train ]; then wants_train=true; else extras+=("$extra"); fi
    done
    local wanted="."
    [ ${#extras[@]} -eq 0 ] || wanted=".[$(IFS=,; echo "${extras[*]}")]"

    local stamp
    stamp=".venv/set-up-$(cat pyproject.toml tools/setup.sh - <<<"$PWD $*" | sha256sum | cut -c1-16)"
    [ -e "$stamp" ] && return
    local size="a few minutes"
    ! $wants_train || size="3 GB, several minutes"
    say "installing skysweep${*:+ with $*} ($size the first time)"
    pip_install --editable "$wanted"
    if $wants_train; then
        .venv/bin/python -c 'import torch' 2>/dev/null || pip_install "$TORCH"
        pip_install onnx "${YOLOX_NEEDS[@]}"
        pip_install --no-deps "$YOLOX"
    fi
    touch "$stamp"
}

can_render() {
    .venv/bin/python -c 'import moderngl; moderngl.create_context(standalone=True, backend="egl")' 2>/dev/null
}

has_chromium() { command -v chromium || command -v chromium-browser || command -v google-chrome; }

# The wheel of a release holds the page; a checkout builds it.
wants_page() { [[ " $* " =~ \ (dev|web)\  ]]; }

make_venv
install_package "$@"
if wants_page "$@" && ! tools/web.sh; then
    say "the live page is missing (skysweep view, --live); everything else works"
fi
if [[ " $* " == *" dev "* ]] && ! has_chromium >/dev/null && ! apt_install chromium; then
    say "no Chromium: the tests of the live page in a browser are skipped"
fi
if ! can_render; then
    mapfile -t missing < <(missing_packages "${PICTURE_NEEDS[@]}")
    if [ ${#missing[@]} -eq 0 ] || ! apt_install "${missing[@]}" || ! can_render; then
        say "OpenGL does not work here (it needs ${PICTURE_NEEDS[*]}, and the right to install them):"
        say "pictures are rendered with Embree instead, which needs no system package but takes longer"
        install_package embree "$@"
    fi
fi
say "done; the command is .venv/bin/skysweep"
