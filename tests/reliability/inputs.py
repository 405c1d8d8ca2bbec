"""Small valid inputs of every reader, as trees of file contents."""

import base64
import io
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from PIL import Image

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.geometry import make_pose
from kinebench_drake.io.container import write_video
from kinebench_drake.io.npz import pack_arrays
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.track import GripperTrack
from tests.reliability.damage import Tree, npy
from tests.suites.report.synthetic import write_run

SIDE_PX = 96
FRAMES = 4
FPS = 10
CAMERA_KEY = "observation.images.front"

IMAGES = np.zeros((FRAMES, SIDE_PX, SIDE_PX, 3), np.uint8)
IMAGES += np.arange(SIDE_PX, dtype=np.uint8)[None, None, :, None]
for k in range(FRAMES):
    IMAGES[k, 30:60, 10 * k : 10 * k + 20] = (220, 180, 40)
T_S = np.arange(12) / 20
Q = np.pi * np.array([0, 1 / 8, 0, -5 / 8, 0, 3 / 4, 1 / 4]) + 0.1 * np.sin(T_S)[:, None] * np.linspace(1.0, 0.2, 7)
X_BG = make_pose(np.diag([1.0, -1.0, -1.0]), np.stack([0.5 + 0.1 * T_S, 0 * T_S, 0.3 + 0 * T_S], axis=1))


def image_file(kind: str = "png") -> bytes:
    Image.fromarray(IMAGES[0]).save(buffer := io.BytesIO(), format=kind)
    return buffer.getvalue()


def gif() -> bytes:
    first, *others = [Image.fromarray(frame) for frame in IMAGES]
    first.save(buffer := io.BytesIO(), format="gif", save_all=True, append_images=others, duration=100)
    return buffer.getvalue()


def mp4() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_video(Path(folder) / "a.mp4", IMAGES, FPS)
        return (Path(folder) / "a.mp4").read_bytes()


def text(value: object) -> bytes:
    return json.dumps(value).encode()


def lines(rows: Sequence[object]) -> bytes:
    return b"".join(text(row) + b"\n" for row in rows)


def table(columns: Mapping[str, object]) -> bytes:
    parquet.write_table(pyarrow.table(dict(columns)), buffer := io.BytesIO())
    return buffer.getvalue()


def hdf5(**items: object) -> bytes:
    with h5py.File(buffer := io.BytesIO(), "w") as file:
        for name, item in items.items():
            file[name] = item
    return buffer.getvalue()


def videos() -> list[Tree]:
    """Video files, frame folders, arrays, cameras and manifests."""
    camera = text(benchmark_camera().resized(SIDE_PX, SIDE_PX).to_json())
    rows = [
        {"video": "clip.gif", "id": "a", "task": "T", "seed": 3, "model": "m", "prompt": "stack", "fps": 10},
        {"video": "frames", "camera": "c.json", "first_base_from_tcp": np.eye(4).tolist(), "first_frame": "1.png"},
    ]
    return [
        {"clip.mp4": mp4()},
        {"clip.gif": gif(), "camera.json": camera},
        {f"clip/{k}.png": image_file() for k in range(FRAMES)},
        {"clip.npy": npy(IMAGES)},
        {"clip.npz": pack_arrays({"frames": IMAGES, "more": np.zeros(3)})},
        {"manifest.jsonl": lines(rows), "clip.gif": gif(), "c.json": camera, "1.png": image_file()}
        | {f"frames/{k}.png": image_file() for k in range(FRAMES)},
        {"clip.h5": hdf5(**{f"data/demo_{k}/obs/front_image": IMAGES for k in range(2)})},
    ]


def lerobot_videos() -> list[Tree]:
    """LeRobot datasets of version 2 and 3 with a video, and one with images in its table."""
    feature = {"dtype": "video", "shape": [SIDE_PX, SIDE_PX, 3], "names": None}
    info = {"fps": FPS, "features": {CAMERA_KEY: feature}}
    about: dict[str, list[object]] = {"episode_index": [0], "tasks": [["stack"]], "length": [FRAMES]}
    about |= {f"{name}/{index}_index": [0] for name in ("data", f"videos/{CAMERA_KEY}") for index in ("chunk", "file")}
    about |= {f"videos/{CAMERA_KEY}/from_timestamp": [0.0], f"videos/{CAMERA_KEY}/to_timestamp": [FRAMES / FPS]}
    count = {"frame_index": list(range(FRAMES)), "episode_index": [0] * FRAMES}
    inside = {CAMERA_KEY: [{"bytes": image_file(), "path": None}] * FRAMES}
    v3 = {"meta/episodes/chunk-000/file-000.parquet": table(about)}
    return [
        {
            "meta/info.json": text({"codebase_version": "v2.1", **info}),
            "meta/episodes.jsonl": lines([{"episode_index": 0, "tasks": ["stack"], "length": FRAMES}]),
            "data/chunk-000/episode_000000.parquet": table(count),
            f"videos/chunk-000/{CAMERA_KEY}/episode_000000.mp4": mp4(),
        },
        v3
        | {
            "meta/info.json": text({"codebase_version": "v3.0", **info}),
            f"videos/{CAMERA_KEY}/chunk-000/file-000.mp4": mp4(),
        },
        v3
        | {
            "meta/info.json": text(
                {"codebase_version": "v3.0", "fps": FPS, "features": {CAMERA_KEY: {**feature, "dtype": "image"}}}
            ),
            "data/chunk-000/file-000.parquet": table({**count, **inside}),
        },
    ]


def trajectories() -> list[Tree]:
    """Trajectories in npz, csv, ManiSkill's HDF5 and LeRobot's parquet files."""
    n = len(T_S)
    poses = {"t_s": T_S, "base_from_tcp": X_BG, "tracked": np.ones(n, bool), "finger_width_m": np.full(n, 0.04)}
    header = ",".join(["t_s", *(f"q{j}_rad" for j in range(1, 8))])
    rows = "".join(",".join(map(str, row)) + "\n" for row in np.column_stack([T_S, Q]).tolist())
    q = np.hstack([Q, np.full((n, 2), 0.02)]).astype(np.float32)
    env = {"env_id": "StackCube-v1", "env_kwargs": {"sim_config": {"control_freq": 20}}}
    names = [f"joint_{j}.pos" for j in range(1, 8)]
    feature = {"dtype": "float32", "shape": [7], "names": names}
    columns = {"observation.state": list(Q.astype(np.float32)), "timestamp": T_S.astype(np.float32)}
    return [
        {"a.npz": pack_arrays(poses)},
        {"a.npz": pack_arrays({"t_s": T_S, "q": Q})},
        {"a.csv": f"{header}\n{rows}".encode()},
        {
            "demo.h5": hdf5(**{"traj_0/obs/agent/qpos": q, "traj_0/actions": q[1:]}),
            "demo.json": text({"env_info": env, "episodes": [{"episode_id": 0, "episode_seed": 0, "success": True}]}),
        },
        {
            "meta/info.json": text({"codebase_version": "v2.1", "fps": 20, "features": {"observation.state": feature}}),
            "meta/episodes.jsonl": lines([{"episode_index": 0, "tasks": ["stack"]}]),
            "data/chunk-000/episode_000000.parquet": table(
                {**columns, "frame_index": np.arange(n), "episode_index": np.zeros(n, np.int64)}
            ),
        },
    ]


def results() -> list[Tree]:
    """Two output folders of suite runs that can be resumed, merged and compared."""
    n = len(T_S)
    track = GripperTrack(
        t_s=T_S, X_CH=X_BG, X_BG=X_BG, tracked=np.ones(n, bool), confidence=np.full(n, 0.9),
        finger_width_m=np.full(n, 0.04),
    )  # fmt: skip
    header = {"seeds": {"bootstrap": 0}, "versions": {}, "code_sha256": "c", "weights_sha256": "w", "host": {}}
    with tempfile.TemporaryDirectory() as folder:
        for model in ("one", "two"):
            write_run(Path(folder) / model, {"StackCube-v1": [True, False]}, model=model, **header)
        write_track(Path(folder) / "one/tracks/StackCube-v1_s0000.npz", track, None, {})
        return [{p.relative_to(folder).as_posix(): p.read_bytes() for p in Path(folder).rglob("*") if p.is_file()}]


REQUEST_ID = "0" * 36
"""Place of the request's id in an answer."""


def answers() -> list[Tree]:
    """Answers of a world model behind HTTP: the video itself, and one frame for each action."""
    size = {"height": SIDE_PX, "width": SIDE_PX}
    one_to_ten = {"min": 1, "max": 10}
    ranges = {"context_frames": one_to_ten, "prediction_frames": one_to_ten}
    profile = {"profile_id": "franka", "image": size, **ranges, "action": {"dimension": 8}}
    frames = [{"data": base64.b64encode(image_file()).decode()}] * (FRAMES - 1)
    predictions = [{"sample_id": "sample-0", "frames": frames}]
    return [
        {"make.json": text({"video_base64": base64.b64encode(gif()).decode()})},
        {
            "health.json": text({"status": "ready"}),
            "capabilities.json": text({"api_version": "1.0", "model_version": "1", "profiles": [profile]}),
            "predict.json": text({"request_id": REQUEST_ID, "model_version": "1", "predictions": predictions}),
        },
    ]


INPUTS: Mapping[str, Callable[[], list[Tree]]] = {
    "videos": videos,
    "LeRobot videos": lerobot_videos,
    "trajectories": trajectories,
    "results": results,
    "answers": answers,
}
