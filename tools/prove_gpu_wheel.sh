#!/bin/sh
# Installs a wheel with the locked packages of the extra gpu into a new environment, where there need be no GPU:
#   tools/prove_gpu_wheel.sh dist/beltscape-*.whl FOLDER
# FOLDER/venv is made. Its NVRTC compiles the kernels from the wheel's own headers for every architecture, and without a
# driver the program must say in one line that there is no usable GPU.
set -eu
wheel=$(realpath "$1")
mkdir -p "$2"
folder=$(cd "$2" && pwd)
root=$(cd "$(dirname "$0")/.." && pwd)
bin=$folder/venv/bin
"${PYTHON:-python3}" -m venv --clear "$folder/venv"
"$bin/python" -m pip install --quiet --require-hashes -r "$root/requirements/gpu.lock"
"$bin/python" -m pip install --quiet --no-index "${wheel}[gpu]"
"$bin/python" -m pip check
cd "$folder" # away from the sources
"$bin/python" -c "
from beltscape.kernels.cuda.cuda_device import ARCHITECTURES, compile_kernels
from beltscape.kernels.native import source_folder
print('headers in', source_folder())
for architecture in ARCHITECTURES:
    print(architecture, len(compile_kernels(architecture).code), 'bytes')
"
if "$bin/python" -c "
from beltscape.kernels.cuda.cuda_device import is_driver_present
raise SystemExit(is_driver_present())"; then
  code=0
  said=$(BELTSCAPE_KERNELS=cuda "$bin/beltscape" doctor 2>&1) || code=$?
  echo "$said"
  [ "$code" = 2 ] && [ "$(echo "$said" | wc -l)" = 1 ]
fi
