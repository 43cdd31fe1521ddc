#!/bin/sh
# From photos and a style image to frames and a report.
#
#   workflows/scene.sh PHOTOS STYLE_IMAGE WORK [FIT_TIME [STYLE_TIME]]
#
# PHOTOS      what `stylerf import` reads: photos alone, or with transforms.json, a COLMAP model or
#             poses_bounds.npy
# STYLE_IMAGE an image file
# WORK        work folder, created if missing
# FIT_TIME    training time of the field, such as 60s, 5m, 1h (default 5m)
# STYLE_TIME  time of the stylization (default 2m)
#
# Rerun it after an interruption: finished steps are skipped, interrupted ones resume. STYLERF names the program
# (default stylerf), METHOD the method (arf, desrf, snerf or refnpr; default arf), and OPTIONS are flags for every step,
# such as OPTIONS="--seed 7 --quiet".
set -eu

if [ "$#" -lt 3 ] || [ "$#" -gt 5 ]; then
    echo "usage: $0 PHOTOS STYLE_IMAGE WORK [FIT_TIME [STYLE_TIME]]" >&2
    exit 2
fi
photos=$1
style_image=$2
work=$3
fit_time=${4:-5m}
style_time=${5:-2m}
settings=$(dirname "$0")/../examples/render.toml

# OPTIONS holds several words.
# shellcheck disable=SC2086
run() { "${STYLERF:-stylerf}" "$@" ${OPTIONS:-}; }

# A style image night.jpg makes the field night-arf. Characters that artifact names do not allow become _; a name without
# any other is replaced by the file's checksum.
field=$(basename "$style_image")
field=$(printf %s "${field%.*}" | LC_ALL=C sed 's/[^A-Za-z0-9._+-]\{1,\}/_/g; s/^[._+-]*//; s/[._+-]*$//')
method=${METHOD:-arf}
field=${field:-$(cksum <"$style_image" | cut -d ' ' -f 1)}-$method

run import "$photos" "$work"
run fit "$work" --budget "$fit_time"
run eval "$work" --of fit
run stylize "$work" --style "$style_image" --method "$method" --budget "$style_time" --name "$field"
run render "$work" --of "$field" --config "$settings"
run eval "$work" --of "$field"
run verify "$work"
