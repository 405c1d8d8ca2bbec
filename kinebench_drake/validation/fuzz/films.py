"""Small valid inputs of `score`: films, frames, arrays and the datasets that hold them, as trees."""

import io
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import av
import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from av.video.stream import VideoStream
from numpy.typing import NDArray
from PIL import Image

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.mp4 import write_video
from kinebench_drake.trackfile import pack_arrays
from kinebench_drake.validation.fuzz.arrays import npy
from kinebench_drake.validation.fuzz.tree import Tree

SIDE_PX, FRAMES, FPS = 96, 4, 10
_KEY = "observation.images.front"


def pictures() -> NDArray[np.uint8]:
    """(4, 96, 96, 3) RGB: a bright bar that moves over a gradient."""
    frames = np.zeros((FRAMES, SIDE_PX, SIDE_PX, 3), np.uint8)
    frames += np.arange(SIDE_PX, dtype=np.uint8)[None, None, :, None]
    for k, frame in enumerate(frames):
        frame[30:60, 10 * k : 10 * k + 20] = (220, 180, 40)
    return frames


def coded(image: NDArray[np.uint8], kind: str = "png") -> bytes:
    """A picture as a file."""
    Image.fromarray(image).save(buffer := io.BytesIO(), format=kind)
    return buffer.getvalue()


def film(suffix: str = ".mp4") -> bytes:
    """The pictures as a film of the format that a suffix names."""
    frames = pictures()
    if suffix == ".gif":
        first, *others = [Image.fromarray(frame) for frame in frames]
        first.save(buffer := io.BytesIO(), format="gif", save_all=True, append_images=others, duration=100)
        return buffer.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"film{suffix}"
        if suffix == ".mp4":
            write_video(path, frames, FPS)
        else:
            _write(path, frames, {".webm": "libvpx-vp9", ".avi": "mjpeg", ".mkv": "mpeg4", ".mov": "mpeg4"}[suffix])
        return path.read_bytes()


def _write(path: Path, frames: NDArray[np.uint8], codec: str) -> None:
    with av.open(path, "w", options={"fflags": "+bitexact"}) as container:
        stream = cast(VideoStream, container.add_stream(codec, rate=FPS))
        stream.width = stream.height = SIDE_PX
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.thread_count = 1
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def camera() -> dict[str, Any]:
    """What a `camera.json` holds."""
    return dict(benchmark_camera().resized(SIDE_PX, SIDE_PX).to_json())


def text(value: object) -> bytes:
    """A value as the content of a JSON file."""
    return json.dumps(value).encode()


def lines(rows: Sequence[Mapping[str, object]]) -> bytes:
    """Rows as the content of a file of JSON lines."""
    return b"".join(text(row) + b"\n" for row in rows)


def table(columns: Mapping[str, object]) -> bytes:
    """Columns as the content of a parquet file."""
    parquet.write_table(pyarrow.table(dict(columns)), buffer := io.BytesIO())
    return buffer.getvalue()


def film_trees() -> list[Tree]:
    """Films alone in a folder, one of each format."""
    return [{f"clip{suffix}": film(suffix)} for suffix in (".mp4", ".gif", ".webm", ".avi", ".mkv", ".mov")]


def frame_trees() -> list[Tree]:
    """Folders of frames."""
    frames = pictures()
    return [
        {f"clip/frame_{k}.{kind}": coded(frame, form) for k, frame in enumerate(frames)}
        for kind, form in (("png", "png"), ("jpg", "jpeg"))
    ]


def manifest_trees() -> list[Tree]:
    """Manifests with cameras, first frames and poses."""
    rows: list[dict[str, object]] = [
        {"video": "clip.mp4", "id": "a", "task": "StackCube-v1", "seed": 3, "model": "m", "prompt": "stack", "fps": 10},
        {"video": "clip.gif", "frame_period_s": 0.2, "camera": camera(), "first_frame": "first.png"},
        {"video": "frames", "camera": "cameras/c.json", "first_base_from_tcp": np.eye(4).tolist()},
        {"video": "clip.npz", "first_base_from_tcp": np.eye(4).tolist(), "first_finger_width_m": 0.04},
    ]
    tree = {
        "manifest.jsonl": lines(rows),
        "clip.mp4": film(),
        "clip.gif": film(".gif"),
        "clip.npz": pack_arrays({"frames": pictures()}),
        "first.png": coded(pictures()[0]),
        "cameras/c.json": text(camera()),
        **{f"frames/{k}.png": coded(frame) for k, frame in enumerate(pictures())},
    }
    return [tree]


def camera_trees() -> list[Tree]:
    """A camera beside a film."""
    return [{"camera.json": text(camera()), "clip.gif": film(".gif")}]


def array_trees() -> list[Tree]:
    """Videos in npy, npz and HDF5 files."""
    frames = pictures()
    aloha, robomimic = io.BytesIO(), io.BytesIO()
    with h5py.File(aloha, "w") as file:
        rows = [np.frombuffer(coded(frame, "jpeg"), np.uint8) for frame in frames]
        longest = max(map(len, rows))
        file["observations/images/top"] = np.stack([np.pad(row, (0, longest - len(row))) for row in rows])
    with h5py.File(robomimic, "w") as file:
        for k in range(2):
            file[f"data/demo_{k}/obs/front_image"] = frames
    return [
        {"clip.npy": npy(frames)},
        {"clip.npz": pack_arrays({"frames": frames, "more": np.zeros(3)})},
        {"clip.h5": aloha.getvalue()},
        {"clip.h5": robomimic.getvalue()},
    ]


def metadata_trees() -> list[Tree]:
    """Films with labels in Hugging Face's layout."""
    row = {
        "file_name": "a/clip.gif",
        "text": "stack",
        "task": "T",
        "seed": 3,
        "frame_period_s": 0.2,
        "first_frame": "a/f.png",
    }
    films = {"a/clip.gif": film(".gif"), "a/f.png": coded(pictures()[0])}
    csv = ",".join(row) + "\n" + ",".join(map(str, row.values())) + "\n"
    return [
        {"metadata.csv": csv.encode(), **films},
        {"metadata.jsonl": lines([row]), **films},
        {"metadata.parquet": table({key: [value] for key, value in row.items()}), **films},
    ]


def layout_trees() -> list[Tree]:
    """EWMBench's and WorldArena's folders."""
    frames = {f"{k}.jpg": coded(frame, "jpeg") for k, frame in enumerate(pictures())}
    prompt = {"prompt/introduction.txt": b"stack the cube", "prompt/init_frame.png": coded(pictures()[0])}
    ewm = {
        **{f"gt_dataset/task_1/7/{name}": data for name, data in prompt.items()},
        **{f"wan_dataset/task_1/7/1/video/{name}": data for name, data in frames.items()},
    }
    summary = [
        {"gt_path": "data/stack/episode7.mp4", "image": "first_frame/stack/episode7.png", "prompt": ["stack", "b"]}
    ]
    arena = {
        "wan_test/stack_episode_7.gif": film(".gif"),
        "wan_test/summary.json": text(summary),
        "first_frame/stack/episode7.png": coded(pictures()[0]),
        "instructions/stack/episode7.json": text({"instruction": "stack"}),
    }
    return [ewm, arena]


def lerobot_trees() -> list[Tree]:
    """LeRobot datasets of version 2 and 3 with a film, and one with pictures in its table."""
    info = {"fps": FPS, "features": {_KEY: {"dtype": "video", "shape": [SIDE_PX, SIDE_PX, 3], "names": None}}}
    count = list(range(FRAMES))
    rows = table({"frame_index": count, "episode_index": [0] * FRAMES})
    place: dict[str, list[object]] = {f"videos/{_KEY}/{name}": [0] for name in ("chunk_index", "file_index")}
    place |= {f"videos/{_KEY}/from_timestamp": [0.0], f"videos/{_KEY}/to_timestamp": [FRAMES / FPS]}
    about: dict[str, list[object]] = {"episode_index": [0], "tasks": [["stack"]], "length": [FRAMES]}
    about |= {"data/chunk_index": [0], "data/file_index": [0], **place}
    inside = {_KEY: [{"bytes": coded(frame), "path": None} for frame in pictures()]}
    in_table = {"fps": FPS, "features": {_KEY: {"dtype": "image", "shape": [SIDE_PX, SIDE_PX, 3], "names": None}}}
    two = {
        "meta/info.json": text({"codebase_version": "v2.1", "chunks_size": 1000, **info}),
        "meta/episodes.jsonl": lines([{"episode_index": 0, "tasks": ["stack"], "length": FRAMES}]),
        "data/chunk-000/episode_000000.parquet": rows,
        f"videos/chunk-000/{_KEY}/episode_000000.mp4": film(),
    }
    three = {
        "meta/info.json": text({"codebase_version": "v3.0", **info}),
        "meta/camera.json": text(camera()),
        "meta/episodes/chunk-000/file-000.parquet": table(about),
        "data/chunk-000/file-000.parquet": rows,
        f"videos/{_KEY}/chunk-000/file-000.mp4": film(),
    }
    four = {
        "meta/info.json": text({"codebase_version": "v3.0", **in_table}),
        "meta/episodes/chunk-000/file-000.parquet": table({k: v for k, v in about.items() if k not in place}),
        "data/chunk-000/file-000.parquet": table({"frame_index": count, "episode_index": [0] * FRAMES, **inside}),
    }
    return [two, three, four]


def given_trees() -> list[Tree]:
    """Masks, depth and poses of other tools beside a film."""
    mask = np.zeros((FRAMES, SIDE_PX, SIDE_PX), np.uint8)
    mask[:, 30:60, 30:60] = 1
    depth = np.full(mask.shape, 0.8)
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 2, 3] = 0.8
    matrix = "\n".join(" ".join(map(str, row)) for row in poses[0]).encode()
    whole = {"clip.gif": film(".gif")}
    return [
        {
            **whole,
            "masks/clip.npz": pack_arrays({"mask": mask[:, ::4, ::4].repeat(4, 1).repeat(4, 2)}),
            "depth/clip.npy": npy(depth.astype(np.float32)),
            "poses/clip.npz": pack_arrays({"camera_from_hand": poses, "finger_width_m": np.full(FRAMES, 0.04)}),
        },
        {
            **whole,
            **{f"masks/clip/{k}.png": coded(255 * m) for k, m in enumerate(mask)},
            **{f"depth/clip/{k}.png": coded((1000 * d).astype(np.uint16)) for k, d in enumerate(depth)},
            **{f"poses/clip/ob_in_cam/{k}.txt": matrix for k in range(FRAMES)},
            "poses/mesh_from_hand.txt": matrix,
        },
    ]
