#!/usr/bin/env bash
# Runs one gzserver on one world, with a screen of its own, in its own namespaces (see server.py):
#   serve.sh ROOT FOLDER WORLD PORT PLUGINS
# ROOT is a folder made by tools/gazebo-root, or / for this machine's own Gazebo. WORLD is a file in FOLDER.
set -euo pipefail
root=$1 folder=$2 world=$3 port=$4 plugins=$5
display=${DISPLAY:-}

enter() { exec "$@"; }
if [ "$root" != / ]; then
    mount -t proc proc "$root/proc"
    mount --rbind /dev "$root/dev"
    mount -t tmpfs tmpfs "$root/tmp"
    mount --bind "$folder" "$root/mnt"
    folder=/mnt display=
    enter() { exec chroot "$root" "$@"; }
fi
# shellcheck disable=SC2016  # expanded inside
enter /usr/bin/env -i PATH=/usr/local/bin:/usr/bin:/bin HOME=/tmp LANG=C.UTF-8 DISPLAY="$display" \
    folder="$folder" world="$world" port="$port" plugins="$plugins" bash -c '
    set -e
    if [ -e /usr/share/gazebo/setup.sh ]; then . /usr/share/gazebo/setup.sh; fi
    if [ -z "$DISPLAY" ]; then
        Xvfb ":$port" -screen 0 640x480x24 -nolisten tcp -nolisten local >/dev/null 2>&1 &
        export DISPLAY=":$port" LIBGL_ALWAYS_SOFTWARE=1
        until [ -e "/tmp/.X11-unix/X$port" ]; do sleep 0.05; done
    fi
    export GAZEBO_MASTER_URI="http://127.0.0.1:$port" GAZEBO_IP=127.0.0.1 IGN_IP=127.0.0.1
    export GAZEBO_MODEL_DATABASE_URI= GAZEBO_MODEL_PATH="$folder/models"
    export GAZEBO_PLUGIN_PATH="$plugins:${GAZEBO_PLUGIN_PATH:-}"
    exec gzserver --verbose --lockstep "$folder/$world"
'
