#!/bin/sh
# From photos and a painting to frames and a report.
#
#   workflows/scene.sh PHOTOS PAINTING WORK [FIT_TIME [STYLE_TIME]]
#
# PHOTOS      what `stylerf import` reads: photos alone, or with transforms.json, a COLMAP model or
#             poses_bounds.npy
# PAINTING    an image file
# WORK        work folder, made where it does not exist
# FIT_TIME    training time of the field, such as 60s, 5m, 1h (default 5m)
# STYLE_TIME  time of the style steps (default 2m)
#
# Run it again after an interruption: what stands is not made again, what was cut short goes on. STYLERF names the
# program (default stylerf), OPTIONS are flags for every step, such as OPTIONS="--seed 7 --quiet".
set -eu

if [ "$#" -lt 3 ] || [ "$#" -gt 5 ]; then
    echo "usage: $0 PHOTOS PAINTING WORK [FIT_TIME [STYLE_TIME]]" >&2
    exit 2
fi
photos=$1
painting=$2
work=$3
fit_time=${4:-5m}
style_time=${5:-2m}
settings=$(dirname "$0")/../examples/render.toml

# OPTIONS holds several words on purpose.
# shellcheck disable=SC2086
run() { "${STYLERF:-stylerf}" "$@" ${OPTIONS:-}; }

# The field that a painting called night.jpg makes is named night-arf: its file's name, with _ for whatever cannot stand
# in the name of an artifact (its checksum where nothing else is left), and the method (METHOD: arf, desrf, snerf or refnpr).
field=$(basename "$painting")
field=$(printf %s "${field%.*}" | LC_ALL=C sed 's/[^A-Za-z0-9._+-]\{1,\}/_/g; s/^[._+-]*//; s/[._+-]*$//')
method=${METHOD:-arf}
field=${field:-$(cksum <"$painting" | cut -d ' ' -f 1)}-$method

run import "$photos" "$work"
run fit "$work" --budget "$fit_time"
run eval "$work" --of fit
run stylize "$work" --style "$painting" --method "$method" --budget "$style_time" --name "$field"
run render "$work" --of "$field" --config "$settings"
run eval "$work" --of "$field"
run verify "$work"
