"""Open a data set of `ground --format lerobot-v3` with LeRobot itself, and replay its actions.

Written for lerobot 0.4.1 (torch 2.7.1, Python 3.11) in an environment of its own, without this project:

    python -m venv lerobot-env; lerobot-env/bin/pip install lerobot==0.4.1
    lerobot-env/bin/python examples/lerobot/open_dataset.py DIR/lerobot [TRUTH.npz ...]

TRUTH holds the true `base_from_tcp` (T, 4, 4) of each episode in turn, as the files of examples/videos/truth/. Prints
what was read and how far the replayed motion is from the recorded poses and from the truth; fails where the data set is
not sound.
"""

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion wxyz."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def turn(vector: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a rotation vector [rad]."""
    angle = np.linalg.norm(vector)
    axis = vector / angle if angle else vector
    return matrix(np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)]))


def replay(poses: np.ndarray, deltas: np.ndarray) -> tuple[float, float]:
    """Add up changes (T - 1, 6) from the first of the poses (T, 7); return the greatest distance from the others."""
    p = poses[0, :3].copy()
    R = matrix(poses[0, 3:])
    position_m = 0.0
    rotation = 0.0
    for delta, pose in zip(deltas, poses[1:], strict=True):
        p = p + delta[:3]
        R = turn(delta[3:6]) @ R
        position_m = max(position_m, np.linalg.norm(p - pose[:3]))
        rotation = max(rotation, np.abs(R - matrix(pose[3:])).max())
    return position_m, rotation


def main(root: Path, truths: list[Path]) -> None:
    data = LeRobotDataset("local/grounded", root=root, video_backend="pyav")  # needs no system FFmpeg
    print(f"lerobot {version('lerobot')}: {data.num_episodes} episodes, {data.num_frames} frames, {data.fps} fps")
    print("features:", {name: tuple(feature["shape"]) for name, feature in data.features.items()})
    items = [data[k] for k in range(len(data))]
    episodes = np.array([int(item["episode_index"]) for item in items])
    for k in range(data.num_episodes):
        own = [item for item, episode in zip(items, episodes, strict=True) if episode == k]
        column = {name: np.array([np.asarray(item[name]) for item in own], dtype=float) for name in (
            *("observation.state", "observation.tcp_pose", "action", "pose_action", "delta_action", "confidence"),
            *("usable", "gripper_known"),
        )}  # fmt: skip
        image = own[0]["observation.images.benchmark"]
        usable = column["usable"].ravel() > 0
        assert np.isfinite(np.concatenate([values.reshape(len(own), -1) for values in column.values()], axis=1)).all()
        assert np.allclose(column["action"][:-1][usable[:-1]], column["observation.state"][1:][usable[:-1]], atol=1e-6)
        drift_m, turned = replay(column["observation.tcp_pose"], column["delta_action"][:-1])
        assert max(drift_m, turned) < 1e-4, f"the changes add up to another path: {drift_m} m, {turned}"
        print(
            f"episode {k}: {own[0]['task']!r}, images {tuple(image.shape)} from {image.min():.2f} to {image.max():.2f}"
        )
        print(f"    {usable.sum():.0f} of {len(own)} actions usable, the changes add up within {1e3 * drift_m:.3f} mm")
        if k < len(truths):
            X_BG = np.load(truths[k])["base_from_tcp"]
            errors = np.linalg.norm(column["pose_action"][:-1, :3] - X_BG[1:, :3, 3], axis=1)[usable[:-1]]
            median_mm = 1e3 * np.median(errors)
            most_mm = 1e3 * errors.max()
            print(f"    replayed poses are {median_mm:.1f} mm (median), at most {most_mm:.1f} mm, from the truth")


if __name__ == "__main__":
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])
