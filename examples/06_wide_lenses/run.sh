#!/bin/sh
# Wide lenses from images to depth, against the exact truth: a rational lens of 105° and a fisheye of 140° across the diagonal.
#   sh examples/06_wide_lenses/run.sh [FOLDER]                  some ten minutes on two cores
set -eu
scenes=$(dirname "$0")/../02_simulate
out=${1:-out/examples/wide_lenses}

for lens in wide_lens fisheye; do
  beltscape simulate "$scenes/${lens}_calibration.toml" --out "$out/$lens/calibration"
  # each camera's own views choose the lens model; rig.json says which, and how far it is known
  beltscape calibrate "$out/$lens/calibration" --board "$out/$lens/calibration/board.toml" --lens-model auto --out "$out/$lens/rig"
  beltscape simulate belt_loaded --rig "$out/$lens/calibration/truth/rig.json" --height 430 --out "$out/$lens/loaded"
  beltscape reconstruct "$out/$lens/loaded" --rig "$out/$lens/rig/rig.json" --out "$out/$lens/depth"
  beltscape evaluate depth "$out/$lens/depth" --truth "$out/$lens/loaded/truth"
done
