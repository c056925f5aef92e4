#!/bin/sh
# Renders every scene of this folder, each a capture with its truth in truth/.
#   sh examples/02_simulate/run.sh [FOLDER]                     some seven minutes on two cores
set -eu
here=$(dirname "$0")
out=${1:-out/examples/scenes}

for scene in laboratory_calibration module_on_belt belt_loaded belt_moving faults own_rig; do
  beltscape simulate "$here/$scene.toml" --out "$out/$scene"
done

# A scene of the program by its name; what is told goes before the file.
beltscape simulate belt_empty --size quarter --seed 2 --no-speckle --out "$out/belt_empty"
