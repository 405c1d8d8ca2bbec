"""Clips with their truth, as `kinebench-drake suite demos` and `benchmarks.planted_videos` write them."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding.overrides.arrays import true_depth, true_mask
from kinebench_drake.io.camerafile import load_camera
from kinebench_drake.io.npz import open_npz
from kinebench_drake.models.panda.robot import hand_from_tcp
from kinebench_drake.types import Anomaly, AnomalyKind, InitialState


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthClip:
    """A video with its truth."""

    id: str
    task: str
    """Plain task id; empty where the manifest names none."""
    path: Path
    camera: Camera
    t_s: Array
    """(T,) task time [s]."""
    X_CH: Array
    """(T, 4, 4) true pose of panda_hand in the camera frame; NaN where the gripper is not in the picture."""
    finger_width_m: Array
    """(T,) true gap between the pads [m]."""
    depth_m: Array | None
    """(T, H, W) true depth [m], if stored and asked for."""
    mask: NDArray[np.bool_] | None
    """(T, H, W) pixels that show the gripper, if stored."""
    faults: tuple[Anomaly, ...]
    """Planted faults."""

    @property
    def initial_state(self) -> InitialState:
        """The robot in the first frame."""
        X_BG = self.camera.X_BC @ self.X_CH[0] @ hand_from_tcp()
        return InitialState(X_BG=X_BG, finger_width_m=float(self.finger_width_m[0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthClipFile:
    """Where a clip and its truth lie: light enough to be handed to other processes."""

    id: str
    task: str
    """Plain task id; empty where the manifest names none."""
    video: Path
    truth: Path
    camera: Camera
    faults: tuple[Anomaly, ...]
    """Planted faults."""

    def load(self, *, with_depth: bool = False) -> TruthClip:
        """Read the truth, its depth maps only `with_depth`.

        Raises:
            UsageError: the file is damaged, or holds no depth although that is asked for.
        """
        try:
            with open_npz(self.truth) as truth:
                if with_depth and not {"depth_mm", "mask"} <= set(truth.files):
                    raise UsageError(f"{self.id}: its truth holds no depth; make the videos with --with-depth")
                return TruthClip(
                    id=self.id,
                    task=self.task,
                    path=self.video,
                    camera=self.camera,
                    t_s=truth["t_s"],
                    X_CH=truth["camera_from_hand"],
                    finger_width_m=truth["finger_width_m"],
                    depth_m=true_depth(truth) if with_depth else None,
                    mask=true_mask(truth) if "mask" in truth.files else None,
                    faults=self.faults,
                )
        except InputError as error:
            raise UsageError(f"{self.truth.name}: not a readable truth file ({error})") from None

    def digest(self) -> str:
        """A few characters that change with the video or its truth."""
        hashed = blake2b(digest_size=8)
        for path in (self.video, self.truth):
            hashed.update(path.read_bytes())
        return hashed.hexdigest()


def find_clips(folder: Path) -> list[TruthClipFile]:
    """The clips that the manifest of a folder lists, in its order.

    Raises:
        UsageError: there is no manifest, no camera or no truth.
    """
    manifest = folder / "manifest.jsonl"
    if not manifest.is_file():
        raise UsageError(f"{folder.name}: has no manifest.jsonl; make such a folder with `kinebench-drake suite demos`")
    camera = load_camera(folder / "camera.json")
    faults_path = folder / "truth" / "faults.json"
    planted = json.loads(faults_path.read_text()) if faults_path.is_file() else {}
    clips = []
    for number, line in enumerate(manifest.read_text().splitlines(), 1):
        try:
            entry = json.loads(line)
            video = str(entry["video"])
        except (ValueError, KeyError, TypeError):
            raise UsageError(f"{manifest.name} line {number}: expected a JSON object with the key video") from None
        name = Path(video).stem
        truth = folder / "truth" / f"{name}.npz"
        if not truth.is_file():
            raise UsageError(f"{folder.name}: truth/{truth.name} is missing, so errors cannot be measured")
        clips.append(
            TruthClipFile(
                id=name,
                task=str(entry.get("task") or ""),
                video=folder / video,
                truth=truth,
                camera=camera,
                faults=tuple(_fault(f) for f in _as_list(planted.get(name))),
            )
        )
    if not clips:
        raise UsageError(f"{folder.name}: its manifest lists no video")
    return clips


def load_clips(folder: Path, *, with_depth: bool = False) -> list[TruthClip]:
    """All clips of a small folder at once; see `find_clips` and `ClipFile.load`."""
    return [clip.load(with_depth=with_depth) for clip in find_clips(folder)]


def choose(clips: Sequence[TruthClipFile], limit: int | None) -> list[TruthClipFile]:
    """So many of the clips, from all tasks in turn, in the order of the manifest; all of them without a limit."""
    seen: dict[str, int] = {}
    turns = []
    for clip in clips:
        turns.append(seen.get(clip.task, 0))
        seen[clip.task] = turns[-1] + 1
    order = sorted(range(len(clips)), key=lambda i: (turns[i], i))
    return [clips[i] for i in sorted(order[:limit])]


def _as_list(value: object) -> list[dict[str, object]]:
    if value is None:
        return []
    return value if isinstance(value, list) else [value]  # type: ignore[list-item]


def _fault(data: dict[str, object]) -> Anomaly:
    return Anomaly(
        kind=AnomalyKind(data["kind"]),
        frame_start=int(str(data["frame_start"])),
        frame_end=int(str(data["frame_end"])),
        severity=float(str(data["size"])),
    )
