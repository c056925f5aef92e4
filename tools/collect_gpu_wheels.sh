#!/bin/sh
# Collects all that a machine with an Nvidia GPU needs to run benchmarks/gpu.sh without a network:
#   tools/collect_gpu_wheels.sh dist/beltscape-*.whl FOLDER
# FOLDER receives the wheel, those of the extra gpu as requirements/gpu.lock has them, those of the tests as
# requirements/dev.lock has them, and list.txt with the SHA-256 and the bytes of each. Nothing is installed. Environment:
#   PYTHON   of the version and platform of the machine with the GPU (default python3)
# FOLDER and the sources travel; there:
#   WHEELS=FOLDER PYTHON=python3 sh benchmarks/gpu.sh OUT
set -eu
[ $# = 2 ] || { echo "usage: tools/collect_gpu_wheels.sh WHEEL FOLDER" >&2; exit 2; }
[ -f "$1" ] || { echo "there is no wheel $1; run: make wheel" >&2; exit 2; }
root=$(cd "$(dirname "$0")/.." && pwd)
tests="execnet hypothesis iniconfig packaging pluggy pygments pytest pytest-xdist sortedcontainers"
mkdir -p "$2"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
awk -v names=" $tests " '/^[a-z]/ { split($0, parts, "=="); is_taken = index(names, " " parts[1] " ") } is_taken' \
  "$root/requirements/dev.lock" >"$scratch/tests.lock"
"${PYTHON:-python3}" -m pip download --quiet --only-binary=:all: --require-hashes --dest "$2" \
  -r "$root/requirements/gpu.lock" -r "$scratch/tests.lock"
cp "$1" "$2"
cd "$2"
for wheel in *.whl; do
  echo "$(sha256sum "$wheel" | cut -d' ' -f1) $(wc -c <"$wheel") $wheel"
done >list.txt
awk '{ bytes += $2 } END { printf "%d wheels, %.0f MB\n", NR, bytes / 1e6 }' list.txt
