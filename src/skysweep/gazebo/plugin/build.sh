#!/usr/bin/env bash
# Builds the world plugin with the Gazebo 11 that pkg-config finds:  build.sh FOLDER
# The name of the library contains a checksum of its source; an existing library is not built again.
set -euo pipefail
source="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)/gate.cc"
library="$1/libskysweep_gate-$(sha256sum "$source" | cut -c1-12).so"
if [ ! -e "$library" ]; then
    # shellcheck disable=SC2046  # flags are words
    g++ -shared -fPIC -O2 -std=c++17 -Wall -o "$library.part" "$source" $(pkg-config --cflags --libs gazebo)
    mv "$library.part" "$library"
fi
echo "$library"
