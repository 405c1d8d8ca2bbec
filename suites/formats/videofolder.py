"""Videos with a `metadata.jsonl`, readable by Hugging Face's VideoFolder: one per clip, with its caption.

ID.mp4, truth/ID.npz     one per clip
metadata.jsonl           file_name, text (the caption) and content of the clip
manifest.jsonl           the same clips for `kinebench-drake score`
camera.json              the camera of all clips
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
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.formats.demo import Content, Demo, Record, RenderOptions
from kinebench_drake.suites.start import first_facts


def _names(task: str, id: str, clips: int) -> list[str]:
    """Return the names of a demonstration's clips; numbered if its task may take more than one."""
    return [id] if TASKS[task].card.clips == 1 else [f"{id}_c{k}" for k in range(clips)]


class VideoFolder:
    """Format of a video folder."""

    content = Content.VIDEO

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Return video and ground truth of each clip."""
        names = _names(record.task, record.id, record.clips)
        return [path for name in names for path in (folder / f"{name}.mp4", folder / "truth" / f"{name}.npz")]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write video and ground truth of each clip."""
        for k, name in enumerate(_names(demo.rollout.episode.task, demo.id, demo.clips)):
            clip = demo.clip(k)
            if clip.video is None:
                raise SetupError("a video folder needs videos")
            write_arrays(folder / "truth" / f"{name}.npz", clip.truth())
            with disk_errors(f"{name}.mp4"):
                write_video(folder / f"{name}.mp4", clip.video.rgb, demo.options.fps, crf=demo.options.crf)

    def finish(
        self, folder: Path, records: Sequence[Record], options: RenderOptions, about: dict[str, Any]
    ) -> list[Path]:
        """Write metadata, manifest and camera."""
        save_camera(options.camera, folder / "camera.json")
        metadata, manifest = [], []
        for record in records:
            for k, name in enumerate(_names(record.task, record.id, record.clips)):
                common = {"task": record.task, "seed": record.seed}
                timing = {"frames": options.frames, "fps": options.fps, "frame_period_s": options.frame_period_s}
                source = {"suite": about["suite"], "split": about["split"]}
                metadata.append(
                    {
                        "file_name": f"{name}.mp4",
                        "text": record.prompt,
                        **common,
                        "episode": record.id,
                        "clip": k,
                        "clips": record.clips,
                        **timing,
                        "truth": f"truth/{name}.npz",
                        **source,
                        "variant": record.facts["variant"],
                    }
                )
                row = {"video": f"{name}.mp4", "id": name, **common, "prompt": record.prompt, **timing, **source}
                with np.load(folder / "truth" / f"{name}.npz") as truth:
                    manifest.append(row | first_facts(truth["base_from_tcp"][0], float(truth["finger_width_m"][0])))
        write_lines(folder / "metadata.jsonl", metadata)
        write_lines(folder / "manifest.jsonl", manifest)
        return []

    def index_files(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Return metadata, manifest and camera."""
        return [folder / name for name in ("metadata.jsonl", "manifest.jsonl", "camera.json")]
