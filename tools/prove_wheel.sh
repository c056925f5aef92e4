#!/bin/sh
# Installs a wheel into a Debian root that has Python and nothing else, and runs the demo there, as root:
#   tools/prove_wheel.sh dist/beltscape-*.whl ROOT
# ROOT is made by debootstrap if it is absent. The demo's results lie in ROOT/demo afterwards.
set -eu
wheel=$1
root=$2
[ -d "$root/usr" ] || debootstrap --variant=minbase --include=python3,python3-venv bookworm "$root"
for tool in g++ gcc clang cmake make git; do
    if chroot "$root" sh -c "command -v $tool" >/dev/null; then
        echo "the root has $tool: it proves nothing" >&2
        exit 2
    fi
done
cp "$wheel" "$root/root/"
cp /etc/resolv.conf "$root/etc/resolv.conf"
for file in /etc/pip.conf /etc/ssl/certs/ca-certificates.crt; do # a machine may have its own package index
    [ ! -f $file ] || install -D $file "$root$file"
done
rm -rf "$root/opt/beltscape" "$root/demo"
chroot "$root" python3 -m venv /opt/beltscape
chroot "$root" /opt/beltscape/bin/pip install --quiet "/root/$(basename "$wheel")"
chroot "$root" /opt/beltscape/bin/pip check
chroot "$root" /opt/beltscape/bin/beltscape doctor
if grep -qw avx512vl /proc/cpuinfo; then # the module must find the level of this processor by itself
    chroot "$root" /opt/beltscape/bin/beltscape doctor | grep -q "this processor runs .*v4" ||
        { echo "the wheel does not find this processor's level" >&2; exit 1; }
fi
chroot "$root" /opt/beltscape/bin/beltscape demo --out /demo
