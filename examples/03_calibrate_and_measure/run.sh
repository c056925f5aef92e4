#!/bin/sh
# The whole chain on a simulated plant: from board views to cubic millimetres, and how far off they are.
#   sh examples/03_calibrate_and_measure/run.sh [FOLDER]        about four minutes on two cores
set -eu
here=$(dirname "$0")
out=${1:-out/examples/chain}

# The plant: the same five cameras see a board, the empty belt and a heap of rocks. Each folder is a capture.
beltscape simulate calibration --size quarter --frames 16 --out "$out/calibration"
beltscape simulate belt_empty  --size quarter --out "$out/empty"
beltscape simulate belt_loaded --size quarter --out "$out/loaded"

# From here on everything is done as with one's own images; nobody looks into truth/.
beltscape calibrate "$out/calibration" --board "$out/calibration/board.toml" --core cam0 --out "$out/rig"
beltscape reconstruct "$out/empty"  --rig "$out/rig/rig.json" --out "$out/depth_empty"
beltscape reconstruct "$out/loaded" --rig "$out/rig/rig.json" --out "$out/depth_loaded"
beltscape measure volume "$out/depth_loaded/000" --empty "$out/depth_empty/000" --along -150 150 --out "$out/volume"

# And only now the truth.
"${PYTHON:-python3}" "$here/compare.py" "$out"
