#!/usr/bin/env bash
# Submits a closed loop whose world model runs as batch jobs: the export of the episodes, then in turns a job of the model
# and one of the benchmark, each after the one before has succeeded. Call it with the options that choose the episodes:
#
#     export GENERATE=/shared/generate.sbatch VIDEOS=/shared/videos RESULTS=/shared/results
#     examples/cluster/rounds.sh --suite 0 --episodes 20
#
# GENERATE is your job. It is called with a manifest and VIDEOS: for each line it generates VIDEOS/<video> from the image
# <first_frame> beside the manifest and the <prompt>. Without a manifest all episodes are complete: nothing is left to do.
set -euo pipefail

: "${GENERATE:?the job that generates videos}" "${VIDEOS:?the folder for them}" "${RESULTS:?the folder for results}"
KINEBENCH=${KINEBENCH:-kinebench-drake} # or .venv/bin/kinebench-drake
ROUNDS=${ROUNDS:-3}
CPUS=${CPUS:-16}

bench() { # submit a command of the benchmark, which begins after the option of $1
    sbatch --parsable ${1:+"$1"} --cpus-per-task="$CPUS" --time=08:00:00 --wrap "$(printf '%q ' "$KINEBENCH" "${@:2}")"
}

job=$(bench "" suite export "$@" --out "$VIDEOS" --jobs "$CPUS")
manifest=$VIDEOS/manifest.jsonl
for _ in $(seq "$ROUNDS"); do
    job=$(sbatch --parsable --dependency="afterok:$job" "$GENERATE" "$manifest" "$VIDEOS")
    job=$(bench "--dependency=afterok:$job" suite run "$@" --world-model "folder:$VIDEOS" --rounds "$ROUNDS" \
        --out "$RESULTS" --jobs "$CPUS")
    manifest=$RESULTS/ask/manifest.jsonl
done
echo "$job"
