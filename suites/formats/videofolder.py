"""Videos beside a `metadata.jsonl`, as Hugging Face's VideoFolder reads them: one a clip, with its caption.

ID.mp4, truth/ID.npz     one a clip
metadata.jsonl           file_name, text (the caption) and what the clip shows
manifest.jsonl           the same clips for `kinebench-drake score`
camera.json              the camera of all of them
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kinebench_drake.errors import SetupError
from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.io.camerafile import save_camera
from kinebench_drake.io.container import write_video
from kinebench_drake.io.jsonl import write_lines
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.suites.formats.demo import Content, Demo, Record, Shots
from kinebench_drake.suites.start import first_facts
from kinebench_drake.suites.tasks.registry import TASKS


def _names(task: str, id: str, clips: int) -> list[str]:
    """Names of a demonstration's clips; numbered where its task may take more than one."""
    return [id] if TASKS[task].card.clips == 1 else [f"{id}_c{k}" for k in range(clips)]


def _first(truth: Path) -> dict[str, Any]:
    with np.load(truth) as arrays:
        return first_facts(arrays["base_from_tcp"][0], float(arrays["finger_width_m"][0]))


class VideoFolder:
    """See the module."""

    content = Content.FILM

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Video and truth of each clip."""
        names = _names(record.task, record.id, record.clips)
        return [path for name in names for path in (folder / f"{name}.mp4", folder / "truth" / f"{name}.npz")]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write each clip's video and truth."""
        for k, name in enumerate(_names(demo.performance.episode.task, demo.id, demo.clips)):
            clip = demo.clip(k)
            if clip.film is None:
                raise SetupError("a video folder needs films")
            write_arrays(folder / "truth" / f"{name}.npz", clip.truth())
            with disk_errors(f"{name}.mp4"):
                write_video(folder / f"{name}.mp4", clip.film.rgb, demo.shots.fps, crf=demo.shots.crf)

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        """Write metadata, manifest and camera."""
        save_camera(shots.camera, folder / "camera.json")
        metadata, manifest = [], []
        for record in records:
            for k, name in enumerate(_names(record.task, record.id, record.clips)):
                common = {"task": record.task, "seed": record.seed}
                filmed = {"frames": shots.frames, "fps": shots.fps, "frame_period_s": shots.frame_period_s}
                where = {"suite": about["suite"], "split": about["split"]}
                metadata.append(
                    {
                        "file_name": f"{name}.mp4",
                        "text": record.prompt,
                        **common,
                        "episode": record.id,
                        "clip": k,
                        "clips": record.clips,
                        **filmed,
                        "truth": f"truth/{name}.npz",
                        **where,
                        "variant": record.facts["variant"],
                    }
                )
                manifest.append(
                    {"video": f"{name}.mp4", "id": name, **common, "prompt": record.prompt, **filmed, **where}
                    | _first(folder / "truth" / f"{name}.npz")
                )
        write_lines(folder / "metadata.jsonl", metadata)
        write_lines(folder / "manifest.jsonl", manifest)
        return []

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Metadata, manifest and camera."""
        return [folder / name for name in ("metadata.jsonl", "manifest.jsonl", "camera.json")]
