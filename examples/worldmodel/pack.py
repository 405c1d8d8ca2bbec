"""Data pack: demonstrations as small videos, prompts, and where robot and objects are in each frame.

The pack is all that training reads, so it can be carried to another machine:

    SPLIT/TASK_sSEED.mp4    49 frames of 192 x 192 px, H.264; SPLIT is train or test
    SPLIT/TASK_sSEED.npz    poses (T, POSE), recorded when the demonstration was made, and prompt
"""

import json
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .robot import NEAR_M, POSE, SIZE

if TYPE_CHECKING:
    from kinebench_drake.kinematics.plant import ArmPlant

FRAMES = 49
Arrays = tuple[NDArray[np.uint8], NDArray[np.float32], list[str]]
JOINT_AXES_M = ((0, 0), (1, 0), (2, 0.1), (3, 0), (4, 0), (4, 0.1), (5, -0.384), (6, 0), (6, 0.1), (7, 0.1))
"""Points on the joints' axes: number of a link, distance along its z axis."""
HAND_M = np.array([[0, 0, 0, 1], [0, 0.1, 0.05, 1], [0, -0.1, 0.05, 1], [0, 0, 0.1034, 1]])
"""Points of the gripper in panda_hand's frame: wrist, both ends of the hand, TCP. The finger tips follow the gap."""


def write_pack(demos: Path, pack: Path, split: str) -> int:
    """Write the clips of `kinebench-drake suite demos` into a pack as split `train` or `test`; return their number."""
    from kinebench_drake.io.container import write_video
    from kinebench_drake.kinematics.plant import ArmPlant

    (pack / split).mkdir(parents=True, exist_ok=True)
    camera = json.loads((demos / "camera.json").read_text())
    plant = ArmPlant()
    rows = [json.loads(line) for line in (demos / "metadata.jsonl").read_text().splitlines()]
    for row in rows:
        path = pack / split / row["file_name"]
        images = read_video(demos / row["file_name"])
        frames = [cv2.resize(image, (SIZE, SIZE), interpolation=cv2.INTER_AREA) for image in images]
        write_video(path, frames, row["fps"], crf=20)
        poses = measure_pose(camera, dict(np.load(demos / row["truth"])), plant)
        np.savez(path.with_suffix(".npz"), poses=poses, prompt=row["text"])
    return len(rows)


def read_pack(pack: Path, split: str, demos: int | None = None) -> Arrays:
    """Return frames (N, FRAMES, SIZE, SIZE, 3), pose numbers (N, FRAMES, POSE) and prompts of the first `demos` clips
    (all if None) of each task of a split; short clips repeat their last frame."""
    tasks = groupby(sorted((pack / split).glob("*.mp4")), key=lambda path: path.name.rpartition("_s")[0])
    paths = [path for _, own in tasks for path in list(own)[:demos]]
    frames = np.empty((len(paths), FRAMES, SIZE, SIZE, 3), np.uint8)
    poses = np.empty((len(paths), FRAMES, POSE), np.float32)
    prompts = []
    for n, path in enumerate(paths):
        images = read_video(path)
        notes = np.load(path.with_suffix(".npz"))
        chosen = np.minimum(np.arange(FRAMES), len(images) - 1)
        frames[n] = np.stack(images)[chosen]
        poses[n] = notes["poses"][chosen]
        prompts.append(str(notes["prompt"]))
    return frames, poses, prompts


def read_video(path: Path) -> list[NDArray[np.uint8]]:
    """Decode the frames of a video, RGB (H, W, 3)."""
    capture = cv2.VideoCapture(str(path))
    images = []
    while (answer := capture.read())[0]:
        images.append(cv2.cvtColor(answer[1], cv2.COLOR_BGR2RGB))
    if not images:
        raise ValueError(f"{path}: no frame can be decoded; expected a video of {FRAMES} frames")
    return images


def measure_pose(camera: dict[str, Any], truth: dict[str, NDArray[Any]], plant: "ArmPlant") -> NDArray[np.float32]:
    """Return the pose numbers (T, POSE) of a demonstration from its recorded joints, hand and objects."""
    X_CB = np.linalg.inv(np.array(camera["base_from_camera"]))
    count = len(truth["q"])
    links = [plant.link_poses(q) for q in truth["q"]]
    arm = np.array([[X_BL[f"panda_link{n}"] @ [0, 0, z_m, 1] for n, z_m in JOINT_AXES_M] for X_BL in links])
    tips_m = np.tile([0, 0, HAND_M[3, 2], 1.0], (count, 2, 1))
    tips_m[:, :, 1] = truth["finger_width_m"][:, None] * [0.5, -0.5]
    hand = np.concatenate([np.broadcast_to(HAND_M, (count, *HAND_M.shape)), tips_m], axis=1)
    X_BO = truth["base_from_object"][:, [0, -1]]
    objects = (X_BO[:, :, None] @ np.array([[0, 0, 0, 1], [0.05, 0, 0, 1]])[..., None])[..., 0].reshape(count, 4, 4)
    in_camera = [arm @ X_CB.T, hand @ truth["camera_from_hand"].transpose(0, 2, 1), objects @ X_CB.T]
    p_C = np.concatenate(in_camera, axis=1)
    z = np.maximum(p_C[..., 2:3], 0.1)
    uv = (p_C[..., :2] / z * [camera["fx"], camera["fy"]] + [camera["cx"], camera["cy"]]) * 2 / camera["width"] - 1
    joint = truth["joint_position"][:, :1] if truth["joint_position"].shape[1] else np.zeros((count, 1))
    points = np.concatenate([uv, NEAR_M / z - 1], axis=2).reshape(count, -1)
    return np.concatenate([points, joint], axis=1).astype(np.float32)
