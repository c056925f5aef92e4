#!/bin/sh
# From a belt to a rig: how high, how far apart, how precise, how fast. report.html first.
#   sh examples/00_plan_a_rig/run.sh [FOLDER]                   five seconds
set -eu
here=$(dirname "$0")
out=${1:-out/examples/plan}

beltscape plan --plan "$here/plan.toml" --out "$out"

# Options go before the file: what would a 6 mm lens do?
beltscape plan --plan "$here/plan.toml" --focal 6 --out "$out-6mm"
