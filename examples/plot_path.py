"""Track the gripper in one video and plot its path, its height and the gap between the fingers.

python examples/plot_path.py [VIDEO [PICTURE.png]]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from kinebench_drake import ground_video

HERE = Path(__file__).parent
VIDEO = HERE / "videos" / "PickFruits-v1_s0010_unseen.mp4"


def main(video: Path, picture: Path) -> None:
    grounded = ground_video(video, frame_period_s=0.2)
    track = grounded.track
    p_BG = track.X_BG[:, :3, 3]  # (T, 3) TCP in the robot's base frame [m]; NaN where it is not tracked

    figure = Figure(figsize=(9, 4), layout="constrained")
    above, beside = figure.subplots(1, 2)
    points = above.scatter(p_BG[:, 1], p_BG[:, 0], c=track.t_s, s=14)
    above.set(xlabel="y [m], the robot's left", ylabel="x [m], ahead of the robot", title="seen from above")
    above.set_aspect("equal")
    above.invert_xaxis()
    figure.colorbar(points, label="task time [s]")
    beside.plot(track.t_s, 1000 * p_BG[:, 2], label="height")
    beside.plot(track.t_s, 1000 * track.finger_width_m, label="gap between the pads")
    for anomaly in grounded.anomalies:
        beside.axvspan(*track.t_s[[anomaly.frame_start, anomaly.frame_end]], alpha=0.2, label=anomaly.kind.value)
    beside.set(xlabel="task time [s]", ylabel="[mm]")
    beside.legend()
    figure.savefig(picture, dpi=120)

    length_m = np.nansum(np.linalg.norm(np.diff(p_BG, axis=0), axis=1))
    print(f"{track.tracked.mean():.0%} of {len(track.t_s)} frames tracked, path of {length_m:.2f} m: {picture}")


if __name__ == "__main__":
    paths = [Path(argument) for argument in sys.argv[1:]]
    main(*paths, *[VIDEO, Path("path.png")][len(paths) :])
