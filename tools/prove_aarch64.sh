#!/bin/sh
# Compiles the kernels for 64-bit ARM (NEON) and runs their tests under an emulator, on any Linux machine:
#   tools/prove_aarch64.sh FOLDER
# FOLDER takes a Debian root of that processor, Python packages and the compiled module. Needs the environments of
# `make dev` and `make wheel`, and Debian's packages debootstrap and qemu-user-static; two cores take half an hour.
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
python=$here/.venv/bin/python
zig="$here/.venv-wheel/bin/python -m ziglang c++ -target aarch64-linux-gnu.2.28"
folder=$(mkdir -p "$1" && cd "$1" && pwd)
cd "$folder"

if [ ! -x root/usr/bin/python3.11 ]; then # unpacked, not configured: that would need the kernel's support of emulators
    debootstrap --foreign --arch=arm64 --variant=minbase --include=python3,libstdc++6 bookworm root
    for package in root/var/cache/apt/archives/*.deb; do dpkg-deb -x "$package" root; done
fi
if [ ! -d site ]; then
    "$python" -m pip download --quiet --only-binary=:all: --python-version 3.11 --implementation cp --dest wheels \
        --platform manylinux_2_28_aarch64 --platform manylinux_2_27_aarch64 --platform manylinux2014_aarch64 \
        numpy scipy opencv-python-headless pydantic threadpoolctl pyyaml tifffile pytest hypothesis
    mkdir site
    for wheel in wheels/*.whl; do "$python" -m zipfile -e "$wheel" site; done
fi

nanobind=$("$python" -c 'import nanobind; print(nanobind.include_dir())')
headers=$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')
flags="-std=gnu++20 -fPIC -fvisibility=hidden -DNDEBUG -isystem $headers -isystem $nanobind"
mkdir -p objects
$zig $flags -O2 -w -fno-strict-aliasing -I"$nanobind/../ext/robin_map/include" \
    -c "$nanobind/../src/nb_combined.cpp" -o objects/nanobind.o
for source in "$here"/native/module.cpp "$here"/native/*/bind.cpp; do
    $zig $flags -O3 -I"$here/native" -DBELTSCAPE_MODULE=_native_base -fno-math-errno -fno-trapping-math \
        -ffp-contract=off -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Werror -Wno-sign-conversion \
        -c "$source" -o "objects/$(basename "$(dirname "$source")")_$(basename "$source").o"
done
rm -rf tree && mkdir tree
cp -r "$here/src/beltscape" "$here/tests" tree/
find tree -name '*.so' -delete
$zig -shared -o tree/beltscape/kernels/_native_base.cpython-311-aarch64-linux-gnu.so objects/*.o -lpthread

cd tree
exec qemu-aarch64-static -L "$folder/root" -E PYTHONPATH="$folder/site:$folder/tree" \
    "$folder/root/usr/bin/python3.11" -m pytest -q -p no:cacheprovider tests/kernels \
    --ignore tests/kernels/test_cuda_compile.py
