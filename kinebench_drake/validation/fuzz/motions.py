"""Small valid inputs of `audit`, as trees."""

import io

import h5py
import numpy as np

from kinebench_drake.geometry import Array, make_pose
from kinebench_drake.trackfile import pack_arrays
from kinebench_drake.trajectories.table import JOINTS, POSE
from kinebench_drake.validation.fuzz.films import lines, table, text
from kinebench_drake.validation.fuzz.tree import Tree

_FRAMES, _RATE_HZ = 12, 20


def joints() -> Array:
    """(12, 7) joint angles of a small move [rad]."""
    rest = np.pi * np.array([0.0, 1 / 8, 0.0, -5 / 8, 0.0, 3 / 4, 1 / 4])
    return np.asarray(rest + 0.1 * np.sin(times())[:, None] * np.linspace(1.0, 0.2, 7))


def times() -> Array:
    """(12,) times [s]."""
    return np.arange(_FRAMES) / _RATE_HZ


def poses() -> Array:
    """(12, 4, 4) poses of the TCP in the base frame [m]."""
    p = np.stack([0.5 + 0.1 * times(), np.zeros(_FRAMES), np.full(_FRAMES, 0.3)], axis=1)
    return make_pose(np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (_FRAMES, 3, 3)), p)


def npz_trees() -> list[Tree]:
    """Trajectories in npz files."""
    width, tracked = np.full(_FRAMES, 0.04), np.ones(_FRAMES, dtype=bool)
    by_poses = {"t_s": times(), "base_from_tcp": poses(), "tracked": tracked, "finger_width_m": width}
    return [
        {"a.npz": pack_arrays(by_poses), "b.npz": pack_arrays({"t_s": times(), "q": joints()})},
        {"a.npz": pack_arrays({"t_s": times(), "q": np.hstack([joints(), np.full((_FRAMES, 2), 0.02)])})},
    ]


def csv_trees() -> list[Tree]:
    """Trajectories in csv files."""
    quaternion = np.tile([0.0, 1.0, 0.0, 0.0], (_FRAMES, 1))
    return [
        {"a.csv": _csv(("t_s", *JOINTS), np.column_stack([times(), joints()]))},
        {"a.csv": _csv(("t_s", *POSE), np.column_stack([times(), poses()[:, :3, 3], quaternion]))},
    ]


def _csv(header: tuple[str, ...], rows: Array) -> bytes:
    return "".join(f"{','.join(map(str, row))}\n" for row in (header, *rows.tolist())).encode()


def maniskill_trees() -> list[Tree]:
    """ManiSkill's recordings with their descriptions."""
    q = np.hstack([joints(), np.full((_FRAMES, 2), 0.02)]).astype(np.float32)
    state = np.zeros((_FRAMES, 13 + 18), np.float32)
    state[:, 13:22] = q
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file["traj_0/obs/agent/qpos"] = q
        file["traj_0/actions"] = q[1:]
        file["traj_1/env_states/articulations/panda_wristcam"] = state
        file["traj_1/env_states/actors/cube"] = state[:, :13]
    episodes = [{"episode_id": k, "episode_seed": k, "success": True} for k in range(2)]
    info = {"env_id": "StackCube-v1", "env_kwargs": {"sim_config": {"control_freq": _RATE_HZ}}}
    return [{"demo.h5": buffer.getvalue(), "demo.json": text({"env_info": info, "episodes": episodes})}]


def lerobot_trees() -> list[Tree]:
    """LeRobot datasets of version 2 and 3, with joint angles and with poses."""
    names = [f"joint_{j}.pos" for j in range(1, 8)]
    pose = ["x", "y", "z", "roll", "pitch", "yaw", "gripper_width"]
    numbers = np.column_stack([poses()[:, :3, 3], np.full((_FRAMES, 3), 0.1), np.full(_FRAMES, 0.04)])
    trees: list[Tree] = []
    for version, elements, values in (("v2.1", names, joints()), ("v3.0", pose, numbers)):
        feature = {"dtype": "float32", "shape": [7], "names": elements}
        info = {"codebase_version": version, "fps": _RATE_HZ, "features": {"observation.state": feature}}
        data = table(
            {
                "observation.state": list(values.astype(np.float32)),
                "timestamp": times().astype(np.float32),
                "frame_index": np.arange(_FRAMES),
                "episode_index": np.zeros(_FRAMES, np.int64),
            }
        )
        about = {"episode_index": [0], "tasks": [["stack"]], "data/chunk_index": [0], "data/file_index": [0]}
        if version.startswith("v2"):
            described = {"meta/episodes.jsonl": lines([{"episode_index": 0, "tasks": ["stack"]}])}
            file = "data/chunk-000/episode_000000.parquet"
        else:
            described = {"meta/episodes/chunk-000/file-000.parquet": table(about)}
            file = "data/chunk-000/file-000.parquet"
        trees.append({"meta/info.json": text(info), **described, file: data})
    return trees
