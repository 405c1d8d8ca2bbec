#!/bin/sh
# Suite 3 with trainings of four lengths, and with fewer demonstrations at the third: sh examples/worldmodel/study.sh PACK WEIGHTS OUT [EPISODES]
# WEIGHTS holds the trained model (train --steps 15000 --levels 1500,3000,4500). The dynamics differ from training to
# training; all paint with the same decoder, which has seen all demonstrations. The longest training is put in closed
# loop; then every training is judged by one clip an episode, so that verdict and success are those of the same clip.
# JOBS=2 uses two processes. Called again, it goes on.
set -eu
pack=$1 weights=$2 out=$3 episodes=${4:-20}
tasks=OpenBoxEasy-v1,PullCube-v1,StackCube-v1,StoreCube-v2

suite() { # FOLDER MODEL ARGS...
    folder=$out/$1 model=$2
    shift 2
    kinebench-drake suite run --jobs "${JOBS:-1}" --suite 3 --tasks $tasks --episodes "$episodes" --out "$folder" --world-model "$model" "$@"
}

learned() { # WEIGHTS DYNAMICS
    echo "examples.worldmodel.generator:Learned?weights=$1&dynamics=$2"
}

cell() { # DATA STEPS MODEL
    suite "learned-$1-$2" "$3" --rounds 1 --tag "data=$1" --tag "steps=$2"
}

best=$(learned "$weights" dynamics)
suite best "$best"
for policy in still random oracle; do
    suite $policy $policy
done
cell 100 15000 "$best"
suite transfer "$best" --suite 1 --split unseen --tasks OpenBoxEasy-v2
suite samples "$best" --tasks OpenBoxEasy-v1,PullCube-v1 --samples 8 --rounds 1
for steps in 1500 3000 4500; do
    cell 100 $steps "$(learned "$weights" "$(printf dynamics_%05d $steps)")"
done
for data in 10 25 50; do
    mkdir -p "$weights/$data"
    cp "$weights/autoencoder.safetensors" "$weights/$data"
    python -m examples.worldmodel train dynamics --demos $data --steps 4500 --minutes 100000 --pack "$pack" --out "$weights/$data"
    cell $data 4500 "$(learned "$weights/$data" dynamics)"
done
kinebench-drake suite report "$out/best" "$out/still" "$out/random" "$out/oracle" --out "$out/report"
kinebench-drake suite report "$out"/learned-*/ --out "$out/report-cells"
