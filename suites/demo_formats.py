"""Formats of demonstrations: each writes a part per demonstration, and joins or indexes the parts at the end."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from kinebench_drake.errors import InputError
from kinebench_drake.formats import manifest
from kinebench_drake.formats.camerafile import CAMERA_NAME, save_camera
from kinebench_drake.formats.lerobot import writer as lerobot
from kinebench_drake.geometry import from_quaternion, invert
from kinebench_drake.io.container import write_video
from kinebench_drake.io.jsonl import write_lines
from kinebench_drake.io.npz import write_arrays
from kinebench_drake.suites.clock import CONTROL_PERIOD_S
from kinebench_drake.suites.demo_config import CLIP_STEPS, DemoConfig, FormatKind, RenderOptions
from kinebench_drake.suites.families.registry import TASKS
from kinebench_drake.suites.rollout import Rollout, RolloutVideo, render_video
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.start import first_facts

PARTS = ".parts"
"""Folder of the parts of formats that join them at the end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """Attempt at a demonstration: a line of `demos.jsonl`."""

    id: str
    """Id of the episode."""
    task: str
    seed: int
    prompt: str
    success: bool
    """True if the expert succeeded, which makes the attempt a demonstration."""
    reason: str
    """Reason of a failure; empty on success."""
    progress: float
    """0..1."""
    clips: int
    """Number of clips of 192 control steps."""
    facts: dict[str, Any]
    """Variant, assets, looks and camera."""

    @classmethod
    def from_json(cls, data: object) -> "Record":
        """Parse a line of `demos.jsonl`.

        Raises:
            InputError: it is not a record.
        """
        try:
            return cls(**cast(dict[str, Any], data))
        except TypeError as error:
            raise InputError(f"not a record of a demonstration ({error})") from None


class DemoFormat(ABC):
    """Writer of demonstrations in one format."""

    @abstractmethod
    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Return the files of a demonstration's part."""

    @abstractmethod
    def write_part(self, folder: Path, simulator: Simulator, rollout: Rollout, options: RenderOptions) -> None:
        """Write the part of a rollout that `simulator` has just finished, each file whole or not at all."""

    def finish(self, config: DemoConfig, records: Sequence[Record]) -> list[Path]:
        """Write the files that concern all demonstrations, in the order of their records; the parts are kept.

        Returns:
            The files into which parts were joined; none for formats that keep their parts.
        """
        return []


class VideoFolder(DemoFormat):
    """Videos for Hugging Face's VideoFolder and for `kinebench-drake score`: one per clip, with its caption.

    ID.mp4, truth/ID.npz     one per clip
    metadata.jsonl           file_name, text (the caption) and content of the clip
    manifest.jsonl           the same clips for `kinebench-drake score`
    camera.json              the camera of all clips
    """

    @override
    def part_files(self, folder: Path, record: Record) -> list[Path]:
        names = _clip_names(record.task, record.id, record.clips)
        return [path for name in names for path in (folder / f"{name}.mp4", truth_file(folder, name))]

    @override
    def write_part(self, folder: Path, simulator: Simulator, rollout: Rollout, options: RenderOptions) -> None:
        clips = list(cut_clips(rollout, render_video(simulator, rollout.snapshots), options))
        names = _clip_names(rollout.episode.task, rollout.episode.id, len(clips))
        for name, (clip, video) in zip(names, clips, strict=True):
            write_arrays(truth_file(folder, name), ground_truth(clip, video, options))
            write_video(folder / f"{name}.mp4", video.rgb, options.fps, crf=options.crf)

    @override
    def finish(self, config: DemoConfig, records: Sequence[Record]) -> list[Path]:
        folder = config.out
        options = config.options
        timing = {"frames": options.frames, "fps": options.fps, "frame_period_s": options.frame_period_s}
        source = {"suite": config.suite.number, "split": config.split}
        labels = []
        lines = []
        for record in records:
            common = {"task": record.task, "seed": record.seed}
            for k, name in enumerate(_clip_names(record.task, record.id, record.clips)):
                truth = truth_file(folder, name)
                content = {
                    **common,
                    "episode": record.id,
                    "clip": k,
                    "clips": record.clips,
                    **timing,
                    "truth": truth.relative_to(folder).as_posix(),
                    **source,
                    "variant": record.facts["variant"],
                }
                labels.append({"file_name": f"{name}.mp4", "text": record.prompt, **content})
                line = {"video": f"{name}.mp4", "id": name, **common, "prompt": record.prompt, **timing, **source}
                with np.load(truth) as arrays:
                    first = first_facts(arrays["base_from_tcp"][0], float(arrays["finger_width_m"][0]))
                lines.append({**line, **first})
        save_camera(options.camera, folder / CAMERA_NAME)
        write_lines(folder / "metadata.jsonl", labels)
        write_lines(folder / manifest.NAME, lines)
        return []


def _clip_names(task: str, id: str, clips: int) -> list[str]:
    """Return the names of a demonstration's clips; numbered if its task may take more than one."""
    return [id] if TASKS[task].card.clips == 1 else [f"{id}_c{k}" for k in range(clips)]


class LeRobot(DemoFormat):
    """LeRobot dataset in task time, an episode per demonstration, with truth/ID.npz beside it."""

    @override
    def part_files(self, folder: Path, record: Record) -> list[Path]:
        return [*lerobot.part_files(folder / PARTS, record.id), truth_file(folder, record.id)]

    @override
    def write_part(self, folder: Path, simulator: Simulator, rollout: Rollout, options: RenderOptions) -> None:
        video = render_video(simulator, rollout.snapshots)
        id = rollout.episode.id
        every = options.every
        write_arrays(truth_file(folder, id), ground_truth(rollout, video, options))
        actions = rollout.controls[every - 1 :: every]  # command until the next frame; the last frame repeats it
        action = np.concatenate([actions, actions[-1:]])
        state = np.column_stack([video.q, video.finger_width_m])
        columns = {lerobot.STATE: state, lerobot.POSE: lerobot.pose_columns(video.X_BG), lerobot.ACTION: action}
        lerobot.write_part(folder / PARTS, id, video.rgb, columns, fps=options.fps, crf=options.crf)

    @override
    def finish(self, config: DemoConfig, records: Sequence[Record]) -> list[Path]:
        prompts = {record.id: record.prompt for record in records}
        camera = config.options.camera
        parts = config.out / PARTS
        size = (camera.width, camera.height)
        return lerobot.join_parts(config.out, parts, prompts, config.options.fps, camera, size=size)


FORMATS: dict[FormatKind, DemoFormat] = {
    FormatKind.MP4: VideoFolder(),
    FormatKind.LEROBOT: LeRobot(),
}


def cut_clips(rollout: Rollout, video: RolloutVideo, options: RenderOptions) -> Iterator[tuple[Rollout, RolloutVideo]]:
    """Yield each clip of a rollout with its video; its last frame is the first of the next clip."""
    n = options.frames - 1
    for k in range(len(rollout.controls) // CLIP_STEPS):
        frames = slice(k * n, (k + 1) * n + 1)
        controls = slice(k * CLIP_STEPS, (k + 1) * CLIP_STEPS)
        snapshots = rollout.snapshots[frames]
        yield replace(rollout, snapshots=snapshots, controls=rollout.controls[controls]), video.select(frames)


def truth_file(folder: Path, name: str) -> Path:
    """Return the file with the ground truth of a video."""
    return folder / "truth" / f"{name}.npz"


def ground_truth(rollout: Rollout, video: RolloutVideo, options: RenderOptions) -> dict[str, NDArray[Any]]:
    """Return the ground truth arrays of a video's frames, by name (docs/suites.md)."""
    from kinebench_drake.suites.scene.builder import X_WB

    snapshots = rollout.snapshots
    controls = rollout.controls
    X_BW = invert(X_WB)
    names = list(snapshots[0].objects)
    joints = list(snapshots[0].joints)
    objects = [[snapshot.objects[name] for name in names] for snapshot in snapshots]
    positions = np.array([[snapshot.joints[name] for name in joints] for snapshot in snapshots])
    images: dict[str, NDArray[Any]] = {}
    if options.with_depth:
        images = {"depth_mm": video.depth_mm, "mask": np.packbits(video.mask, axis=-1)}
    return {
        "t_s": options.frame_period_s * np.arange(len(snapshots)),
        "q": np.stack([s.q for s in snapshots]),
        "finger_width_m": np.array([s.finger_width_m for s in snapshots]),
        "control_t_s": CONTROL_PERIOD_S * np.arange(len(controls)),
        "control_q": controls[:, :7],
        "control_finger_width_m": controls[:, 7],
        "base_from_tcp": video.X_BG,
        "camera_from_hand": video.X_CH,
        **images,
        "objects": np.array(names),
        "base_from_object": np.stack([[X_BW @ from_quaternion(raw[3:], raw[:3]) for raw in row] for row in objects]),
        "joints": np.array(joints, dtype=np.str_),
        "joint_position": positions.reshape(len(snapshots), len(joints)),
    }
