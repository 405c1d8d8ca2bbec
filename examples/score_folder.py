"""Score a folder of your videos from Python, and read the results.

    python examples/score_folder.py [FOLDER [OUT]]

FOLDER holds videos (mp4, mov, gif, webm ...) or folders of frames and, where the camera is not the benchmark's, its
camera.json. Without FOLDER: the example videos. A second call evaluates only what is missing.
"""

import sys
from pathlib import Path

from kinebench_drake import read_track, score_videos

HERE = Path(__file__).parent
FRAME_PERIOD_S = 0.2
"""Task time between two frames: that of the benchmark. Leave it out where the film's frame rate is the task's."""


def main(folder: Path, out: Path) -> None:
    summary = score_videos(folder, out=out, frame_period_s=FRAME_PERIOD_S)
    for row in summary.rows:
        if row.status.value != "ok":
            print(f"{row.id}: {row.status.value}, {row.reason}")
            continue
        verdict = {True: "feasible", False: "infeasible", None: "undecided"}[row.feasible]
        why = ", ".join(f"{v.kind.value} in frames {v.frame_start} to {v.frame_end}" for v in row.violations)
        print(f"{row.id}: {verdict}{f' ({why})' if why else ''}")
        whole = {True: "yes", False: "no", None: "undecided"}[row.executable]
        print("  executable as a whole:", ", ".join([whole, *(r for r in row.executable_reasons if r != "undecided")]))
        kinds = ", ".join(anomaly.kind.value for anomaly in row.anomalies)
        print(f"  tracked {row.metrics.tracked_fraction:.0%}, anomalies: {kinds or 'none'}")
        track = read_track(out / "tracks" / f"{row.id}.npz").track
        start, end = track.X_BG[track.tracked][[0, -1], :3, 3]
        print(f"  the gripper goes from {start.round(3)} to {end.round(3)} m in {track.t_s[-1]:.1f} s")
    if summary.executable is not None and summary.executable.mean is not None:
        print(f"{summary.executable.mean:.0%} of {summary.executable.total} videos are executable")
    print(f"report: {summary.report}")


if __name__ == "__main__":  # with jobs above 1 the worker processes import this file, too
    paths = [Path(argument) for argument in sys.argv[1:]]
    main(*paths, *[HERE / "videos" / "manifest.jsonl", Path("scored")][len(paths) :])
