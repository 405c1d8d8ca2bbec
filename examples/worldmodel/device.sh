#!/bin/sh
# Train both stages side by side on one GPU: sh examples/worldmodel/device.sh PACK OUT MINUTES [WORK]
# Needs Python with torch, numpy, opencv, safetensors and click. Called again, it goes on from the state in WORK.
set -eu
pack=$1 out=$2 minutes=$3 work=${4:-/tmp/worldmodel}
mkdir -p "$out" "$work"
train() { PYTHONUNBUFFERED=1 python3 -m examples.worldmodel train "$@" --minutes "$minutes" --pack "$pack" --out "$work"; }
train autoencoder --cool >"$work/autoencoder.log" 2>&1 &
train dynamics --steps 15000 --levels 1500,4500,7500 >"$work/dynamics.log" 2>&1 &
wait
tail -n 3 "$work"/*.log
cp "$work"/*.safetensors "$work"/*.log "$out"
