#!/bin/sh
# What one prints and what one projects.
#   sh examples/01_targets/run.sh [FOLDER]                      ten seconds
set -eu
out=${1:-out/examples/targets}

# A board to calibrate with, in true size: print board.pdf at 100 % and measure its ruler.
beltscape target board --out "$out/board" --squares 12 9 --square 30 --marker 22 --dictionary DICT_5X5_100

# The paper's speckle pattern, 25,000 dots, and a finer one for the same projector.
beltscape target pattern --out "$out/pattern"
beltscape target pattern --out "$out/pattern_fine" --preset fine --seed 7
