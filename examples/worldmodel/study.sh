#!/bin/sh
# Suite 3 with trainings of four lengths, and with fewer demonstrations at the third: sh examples/worldmodel/study.sh PACK WEIGHTS OUT [EPISODES]
# WEIGHTS holds the trained model (train --steps 15000 --levels 1500,4500,7500). The dynamics differ from training to
# training; all paint with the same decoder, which has seen all demonstrations. The longest training is also asked for
# a task that it has not seen, and for eight samples of an episode. JOBS=2 uses two processes. Called again, it goes on.
set -eu
pack=$1 weights=$2 out=$3 episodes=${4:-20}
tasks=OpenBoxEasy-v1,PullCube-v1,StackCube-v1,StoreCube-v2
model=examples.worldmodel.generator:Learned

suite() { # FOLDER ARGS...
    folder=$out/$1
    shift
    kinebench-drake suite run --jobs "${JOBS:-1}" --out "$folder" "$@"
}

cell() { # DATA STEPS FOLDER NAME
    suite "learned-$1-$2" --suite 3 --tasks $tasks --episodes "$episodes" --tag "data=$1" --tag "steps=$2" \
        --world-model "$model?weights=$3&dynamics=$4"
}

cell 100 15000 "$weights" dynamics
for policy in still random oracle; do
    suite $policy --suite 3 --tasks $tasks --episodes "$episodes" --world-model $policy
done
suite transfer --suite 1 --split unseen --tasks OpenBoxEasy-v2 --episodes "$episodes" --world-model "$model?weights=$weights"
suite samples --suite 3 --tasks $tasks --episodes $((episodes / 2)) --samples 8 --rounds 1 --world-model "$model?weights=$weights"
for steps in 1500 4500 7500; do
    cell 100 $steps "$weights" "$(printf dynamics_%05d $steps)"
done
for data in 10 25 50; do
    mkdir -p "$weights/$data"
    cp "$weights/autoencoder.safetensors" "$weights/$data"
    python -m examples.worldmodel train dynamics --demos $data --steps 7500 --minutes 100000 --pack "$pack" --out "$weights/$data"
    cell $data 7500 "$weights/$data" dynamics
done
kinebench-drake suite report "$out"/learned-*/ "$out/still" "$out/random" "$out/oracle" --out "$out/report"
