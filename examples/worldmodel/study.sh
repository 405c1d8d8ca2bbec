#!/bin/sh
# Suite 3 with trainings of four lengths, and with fewer demonstrations at the third: sh examples/worldmodel/study.sh PACK WEIGHTS OUT [EPISODES]
# WEIGHTS holds the trained model (train --steps 15000 --levels 1500,4500,7500). The dynamics differ from training to
# training; all paint with the same decoder, which has seen all demonstrations. Called again, it goes on.
set -eu
pack=$1 weights=$2 out=$3 episodes=${4:-20}
suite="kinebench-drake suite run --suite 3 --episodes $episodes --tasks OpenBoxEasy-v1,PullCube-v1,StackCube-v1,StoreCube-v2"
server=
trap '[ -z "$server" ] || kill "$server"' EXIT

run() { # DATA STEPS FOLDER NAME
    python -m examples.worldmodel serve --weights "$3" --dynamics "$4" --port 8765 &
    server=$!
    $suite --world-model http://127.0.0.1:8765 --model learned --tag "data=$1" --tag "steps=$2" --out "$out/learned-$1-$2"
    kill "$server"
    wait "$server" || true
    server=
}

for steps in 1500 4500 7500; do run 100 $steps "$weights" "$(printf dynamics_%05d $steps)"; done
run 100 15000 "$weights" dynamics
for data in 10 25 50; do
    mkdir -p "$weights/$data"
    cp "$weights/autoencoder.safetensors" "$weights/$data"
    python -m examples.worldmodel train dynamics --demos $data --steps 7500 --minutes 100000 --pack "$pack" --out "$weights/$data"
    run $data 7500 "$weights/$data" dynamics
done
for policy in still random oracle; do $suite --world-model $policy --out "$out/$policy"; done
kinebench-drake suite report "$out"/learned-*/ "$out/still" "$out/random" "$out/oracle" --out "$out/report"
