#!/bin/sh
# Makes a venv with stylerf in it, every dependency pinned and checked by digest:
#
#   requirements/install.sh .venv           what stylerf needs
#   requirements/install.sh .venv test      what its tests need too
#
# $PYTHON names the interpreter (default: python3).
# Where there is no NVIDIA GPU torch is the CPU build, from wherever pip is set up to find it or from pytorch.org.
set -eu
if [ $# -eq 0 ]; then
    echo "usage: sh requirements/install.sh VENV [test]" >&2
    exit 2
fi
venv=$1
here=$(cd "$(dirname "$0")" && pwd)

locked() {
    file=$1
    shift
    "$venv/bin/python" -m pip install --quiet --no-deps --require-hashes -r "$here/$file" "$@"
}

"${PYTHON:-python3}" -m venv "$venv"
gpu=$(ls /dev/nvidiactl /dev/dxg 2> /dev/null || true)
# Quiet at first: PyPI has no such build, and says so at length.
if [ -n "$gpu" ] || ! { locked torch-cpu.txt 2> /dev/null || locked torch-cpu.txt --index-url https://download.pytorch.org/whl/cpu; }; then
    locked torch.txt
fi
locked locked.txt
if [ $# -gt 1 ]; then
    locked "$2.txt"
fi
for package in weights-hed weights-st; do
    locked "$package.txt" || echo "install.sh: going on without $package; \`stylerf doctor\` tells what is missing" >&2
done
"$venv/bin/python" -m pip install --quiet --no-deps --no-build-isolation "$here/.."
