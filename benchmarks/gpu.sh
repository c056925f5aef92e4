#!/bin/sh
# Builds, tests and measures the CUDA back end on a machine with an Nvidia GPU, within eight minutes:
#   sh benchmarks/gpu.sh CAPTURE RIG OUT
# OUT receives GPU.md and the logs of every step, those of a step that fails, too; a step for which no time is left is
# left out and named. The measurement comes first, because it is what the GPU is for. Environment: PYTHON (default
# python3, 3.11 or newer); WHEELS, a folder of wheels for a machine without a network: beltscape's own and what
# requirements/gpu.lock and pytest, pytest-xdist and hypothesis need; VENV, an environment in which all that is installed
# already, and an OpenCV built with CUDA where its SGM shall be measured beside; DEVICE (default cuda; none counts without
# a GPU).
set -u
capture=$(realpath "$1") rig=$(realpath "$2") out=$3
cd "$(dirname "$0")/.." || exit 1
mkdir -p "$out"
out=$(cd "$out" && pwd)
python=${VENV:-$out/venv}/bin/python
failed=0

limit=470 # seconds in all
began=$(date +%s)

step() { # name, seconds, command ...
  name=$1 seconds=$2
  shift 2
  start=$(date +%s)
  left=$((limit - (start - began)))
  if [ "$left" -lt 5 ]; then
    echo "$name: left out, no time is left" | tee -a "$out/steps.txt"
    failed=1
    return 1
  fi
  [ "$seconds" -le "$left" ] || seconds=$left
  timeout "$seconds" "$@" >"$out/$name.log" 2>&1
  code=$?
  echo "$name: exit code $code after $(($(date +%s) - start)) s" | tee -a "$out/steps.txt"
  [ "$code" = 0 ] || failed=1
  return "$code"
}

build() {
  [ -z "${VENV:-}" ] || return 0
  "${PYTHON:-python3}" -m venv --system-site-packages "$out/venv" || return 1
  if [ -n "${WHEELS:-}" ]; then
    "$python" -m pip install --quiet --no-index --find-links "$WHEELS" 'beltscape[gpu]' pytest pytest-xdist hypothesis
  else
    "$python" -m pip install --quiet '.[gpu]' pytest pytest-xdist hypothesis
  fi
}

: >"$out/steps.txt"
start=$(date +%s)
build >"$out/build.log" 2>&1 || { echo "build: failed, see $out/build.log" | tee -a "$out/steps.txt"; exit 1; }
echo "build: $(($(date +%s) - start)) s" | tee -a "$out/steps.txt"
step gpu 10 nvidia-smi
# the capture's own size, and twice it: 2448 × 2048 px from 1224 × 1024
step measure 240 "$python" benchmarks/gpu.py "$capture" --rig "$rig" --device "${DEVICE:-cuda}" --scales 1 2 \
  --out "$out/GPU.md"
step tests 120 "$python" -m pytest -n0 -m gpu tests/kernels/test_gpu.py
if command -v compute-sanitizer >/dev/null; then
  for tool in memcheck racecheck; do
    step "$tool" 60 compute-sanitizer --tool "$tool" --error-exitcode 3 "$python" -m pytest -n0 -m gpu \
      tests/kernels/test_gpu.py -k self_test
  done
fi
exit "$failed"
