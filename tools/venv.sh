#!/bin/sh
# Makes the virtual environment, also where Debian's python3 came without venv, pip or headers.
set -eu
venv=$1
python=${PYTHON:-python3}

complete() { # headers for the native build, ensurepip for the environment
    "$python" -c 'import ensurepip, pathlib, sysconfig
assert (pathlib.Path(sysconfig.get_path("include")) / "Python.h").is_file()' 2>/dev/null
}

command -v "$python" >/dev/null || { echo "beltscape: no $python here; install Python 3.11 or set PYTHON=" >&2; exit 2; }
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    { echo "beltscape: $("$python" --version) is too old; Python 3.11 or newer is needed (set PYTHON=)" >&2; exit 2; }

if ! complete && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing Debian's python3-venv and python3-dev" >&2
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
        python3-venv python3-dev; } >/dev/null
fi
complete || { echo "beltscape: $python lacks venv or its headers; run: apt-get install python3-venv python3-dev" >&2; exit 2; }
exec "$python" -m venv "$venv"
