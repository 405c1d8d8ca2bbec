"""Small films whose grey tells which frame of which episode is seen, and datasets of them."""

import json
import os
from contextlib import contextmanager

import av
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest

from kinebench_drake.io.container import join_videos, write_video

SIDE = 96


def grey(episode, frame):
    return 20 + 60 * episode + 5 * frame


def frames_of(episode, count):
    return np.stack([np.full((SIDE, SIDE, 3), grey(episode, k), np.uint8) for k in range(count)])


def levels(frames):
    """The grey of each frame, in the middle of the picture."""
    return frames[:, 30:60, 30:60].mean(axis=(1, 2, 3))


@contextmanager
def usual_priority():
    """SVT-AV1 gives the thread that starts it real-time priority, where it may, and leaves it there."""
    policy = os.sched_getscheduler(0)
    parameters = os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, parameters)


def write_av1(path, frames, fps):
    with usual_priority(), av.open(path, "w") as container:
        stream = container.add_stream("libsvtav1", rate=fps, options={"preset": "12", "crf": "20", "g": "2"})
        stream.height, stream.width, stream.pix_fmt = *frames.shape[1:3], "yuv420p"
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())


def write_v3_episodes(root, keys, lengths, fps):
    """meta/episodes of a v3 dataset whose episodes follow each other in one file."""
    begins = np.cumsum([0, *lengths])
    rows = [
        {
            "episode_index": k,
            "tasks": [f"task {k}"],
            "length": n,
            "data/chunk_index": 0,
            "data/file_index": 0,
            **{f"videos/{key}/{name}_index": 0 for key in keys for name in ("chunk", "file")},
            **{f"videos/{key}/from_timestamp": float(begins[k] / fps) for key in keys},
            **{f"videos/{key}/to_timestamp": float(begins[k + 1] / fps) for key in keys},
        }
        for k, n in enumerate(lengths)
    ]
    path = root / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pyarrow.Table.from_pylist(rows), path)


def write_info(root, version, fps, features, **more):
    (root / "meta").mkdir(parents=True, exist_ok=True)
    info = {"codebase_version": version, "fps": fps, "features": features, **more}
    (root / "meta" / "info.json").write_text(json.dumps(info))


@pytest.fixture
def lerobot(tmp_path):
    """Writes a LeRobot dataset of grey films, one camera a key; returns its folder."""

    def write(version, lengths=(5, 4, 6), keys=("observation.images.front",), fps=10, codec="h264"):
        root = tmp_path / "ds"
        write_info(root, version, fps, {key: {"dtype": "video", "shape": [SIDE, SIDE, 3]} for key in keys})
        films = [frames_of(k, n) for k, n in enumerate(lengths)]
        for key in keys:
            if version.startswith("v3"):
                path = root / "videos" / key / "chunk-000" / "file-000.mp4"
                path.parent.mkdir(parents=True)
                if codec == "av1":
                    write_av1(path, np.concatenate(films), fps)
                else:
                    parts = [root / f"part{k}.mp4" for k in range(len(films))]
                    for part, film in zip(parts, films, strict=True):
                        write_video(part, film, fps, crf=4)
                    join_videos(path, parts)
                    for part in parts:
                        part.unlink()
            else:
                for k, film in enumerate(films):
                    path = root / "videos" / "chunk-000" / key / f"episode_{k:06d}.mp4"
                    path.parent.mkdir(parents=True, exist_ok=True)
                    write_video(path, film, fps, crf=4)
        if version.startswith("v3"):
            write_v3_episodes(root, keys, lengths, fps)
        else:
            told = [{"episode_index": k, "tasks": [f"task {k}"], "length": n} for k, n in enumerate(lengths)]
            (root / "meta" / "episodes.jsonl").write_text("".join(json.dumps(row) + "\n" for row in told))
            for k in range(len(lengths)):
                path = root / "data" / "chunk-000" / f"episode_{k:06d}.parquet"
                path.parent.mkdir(parents=True, exist_ok=True)
                parquet.write_table(pyarrow.table({"frame_index": [0]}), path)
        return root

    return write


def touch(folder, *names):
    """Write files of one byte."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
