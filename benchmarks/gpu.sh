#!/bin/sh
# Builds, tests and measures the CUDA back end on a machine with an Nvidia GPU, within eight minutes:
#   sh benchmarks/gpu.sh OUT [CAPTURE RIG]
# OUT receives three files: GPU.md, steps.txt (how each step ended) and gpu.log (all that they print). A step that fails
# stops none of the later ones, and one for which no time is left is left out and named. Without a capture the demo's is
# taken, enlarged to 1224 × 1024 and 2448 × 2048 px; neither nvcc nor a network is needed. Environment:
#   PYTHON   3.11 or newer (default python3), in whose packages nothing is changed
#   WHEELS   a folder of wheels for a machine without a network, collected on another one with the same PYTHON:
#              PYTHON=python3.12 make wheel VENV=.venv312
#              PYTHON=python3.12 tools/collect_gpu_wheels.sh dist/beltscape-*-cp312-*.whl WHEELS
#   VENV     in place of both, an environment in which all is installed; one whose OpenCV was built with CUDA has its SGM
#            measured beside
#   SCALES   of the images (default 2 4 for the demo's capture, 1 2 for another)
#   DEVICE   cuda; none counts without a GPU
set -u
case $# in
  1) given="" ;;
  3) given=1 capture=$(realpath "$2") rig=$(realpath "$3") ;;
  *) echo "usage: sh benchmarks/gpu.sh OUT [CAPTURE RIG]" >&2; exit 2 ;;
esac
mkdir -p "$1" || exit 2
out=$(cd "$1" && pwd)
[ -z "${WHEELS:-}" ] || WHEELS=$(realpath "$WHEELS")
cd "$(dirname "$0")/.." || exit 2
if [ -z "$given" ]; then
  demo=$PWD/src/beltscape/data/demo
  capture=$demo/belt_loaded rig=$demo/truth/rig.json
fi
scales=${SCALES:-$([ -n "$given" ] && echo 1 2 || echo 2 4)}
folder=$(mktemp -d) # what is installed, so that OUT holds the results alone
trap 'rm -rf "$folder"' EXIT
failed=0

limit=470 # seconds in all: the sum of the steps' limits
began=$(date +%s)
: >"$out/steps.txt"
: >"$out/gpu.log"

note() {
  echo "$1: $2" | tee -a "$out/steps.txt"
}

step() { # name, seconds, command ...
  name=$1 seconds=$2
  shift 2
  start=$(date +%s)
  left=$((limit - (start - began)))
  if [ "$left" -lt 5 ]; then
    note "$name" "left out, no time is left"
    failed=1
    return 1
  fi
  [ "$seconds" -le "$left" ] || seconds=$left
  echo "=== $name" >>"$out/gpu.log"
  timeout -k 2 "$seconds" "$@" >>"$out/gpu.log" 2>&1 </dev/null
  code=$?
  note "$name" "exit code $code after $(($(date +%s) - start)) s"
  [ "$code" = 0 ] || failed=1
  return "$code"
}

build() {
  python=${VENV:+$VENV/bin/python}
  [ -z "$python" ] || return 0
  python=${PYTHON:-python3}
  if [ -n "${WHEELS:-}" ]; then # beside PYTHON's packages: an environment would not see those of another environment
    export PYTHONPATH="$folder/site"
    step build 90 "$python" -m pip install --quiet --no-index --no-deps --target "$folder/site" "$WHEELS"/*.whl
    return
  fi
  step environment 15 "$python" -m venv --system-site-packages "$folder/venv" || return 1
  python=$folder/venv/bin/python
  step build 90 "$python" -m pip install --quiet '.[gpu]' pytest pytest-xdist hypothesis
}

if ! build; then
  echo "nothing is measured: the packages are not there, see $out/gpu.log"
  exit 1
fi
export PYTHONUNBUFFERED=1
device=${DEVICE:-cuda}
step gpu 5 nvidia-smi
step check 40 "$python" benchmarks/gpu_check.py --device "$device"
step measure 150 "$python" benchmarks/gpu.py "$capture" --rig "$rig" --device "$device" --scales $scales \
  --out "$out/GPU.md"
step tests 70 "$python" -m pytest -n0 -m gpu -p no:cacheprovider tests/kernels/test_gpu.py
for tool in memcheck racecheck; do
  if command -v compute-sanitizer >/dev/null; then
    step "$tool" 50 compute-sanitizer --tool "$tool" --error-exitcode 3 "$python" benchmarks/gpu_check.py \
      --device "$device"
  else
    note "$tool" "left out, there is no compute-sanitizer"
  fi
done
echo "results:" "$out"/GPU.md "$out"/steps.txt "$out"/gpu.log
[ -f "$out/GPU.md" ] || echo "there is no GPU.md: see the step measure in gpu.log"
exit "$failed"
