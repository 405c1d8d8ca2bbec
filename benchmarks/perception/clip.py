"""Videos with ground truth, as `kinebench-drake suite demos` and `python -m benchmarks planted-videos` write them.

Videos of other programs and cameras may have a camera each in the manifest, and other truth (`TRUTHS`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, TypeAdapter

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, UsageError, cause
from kinebench_drake.formats.camerafile import load_camera
from kinebench_drake.formats.manifest import NAME, entry_camera, read_manifest
from kinebench_drake.geometry import Array, invert
from kinebench_drake.grounding.overrides.files import true_depth, true_mask
from kinebench_drake.grounding.tracking.view import Crop
from kinebench_drake.io.npz import open_npz
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.panda.description import hand_from_tcp
from kinebench_drake.track import InitialState

TRUTHS = ("truth/{}.npz", "{}.gt.npz", "gt/{}.npz", "gt/{}.edge.npz")
"""Files of ground truth: of the suites; exact poses of another renderer; of a real arm from its joint angles; of an arm
fitted to image edges. They hold `camera_from_hand` or `base_from_hand`, and `finger_width_m`."""
_MARGIN = 1.1
"""Half width of a crop over the gripper's radius."""
_MASK_PX = 160
"""Width of the crop in which silhouettes for masks are rendered [px]."""
_SHARE_PX = 64
"""Width of the crop in which silhouettes for visible shares are rendered [px]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthClip:
    """Ground truth of one video."""

    id: str
    task: str
    """Plain task id; empty if the manifest has none."""
    path: Path
    """Video file."""
    camera: Camera
    t_s: Array
    """(T,) task time [s]."""
    X_CH: Array
    """(T, 4, 4) true pose of panda_hand in the camera frame; NaN where the gripper is absent."""
    finger_width_m: Array
    """(T,) true gap between the finger pads [m]."""
    depth_m: Array | None
    """(T, H, W) true depth [m]; None if not stored or not requested."""
    mask: NDArray[np.bool_] | None
    """(T, H, W) gripper pixels; None if not stored."""
    faults: tuple[Anomaly, ...]
    """Planted anomalies."""
    visible_px: NDArray[np.int64] | None = None
    """(T,) pixels that show the gripper; None if not counted."""

    @property
    def initial_state(self) -> InitialState:
        """State of the robot in the first frame."""
        X_BG = self.camera.X_BC @ self.X_CH[0] @ hand_from_tcp()
        return InitialState(X_BG=X_BG, finger_width_m=float(self.finger_width_m[0]))

    def masks(self, cad: GripperCad) -> NDArray[np.bool_]:
        """Return the gripper masks (T, H, W): those stored, else the silhouettes of the CAD model at the true poses.

        Silhouettes ignore occlusion by the arm and by objects.
        """
        if self.mask is not None:
            return self.mask
        masks = np.zeros((len(self.t_s), self.camera.height, self.camera.width), dtype=bool)
        for i, X_CH in enumerate(self.X_CH):
            if np.isfinite(X_CH).all() and X_CH[2, 3] > 0:
                crop, hit = _silhouette(X_CH, float(self.finger_width_m[i]), cad, _MASK_PX)
                masks[i] = crop.unwarp(hit.astype(np.uint8), self.camera) > 0
        return masks

    def visible_share(self, masks: NDArray[np.bool_], cad: GripperCad) -> Array:
        """Return the share (T,) of the gripper's silhouette that `masks` (T, H, W) cover.

        The silhouette includes what lies outside the image. NaN where the gripper is absent.
        """
        share = np.full(len(self.t_s), np.nan)
        for i, X_CH in enumerate(self.X_CH):
            if not np.isfinite(X_CH).all():
                continue
            if X_CH[2, 3] <= 0:
                share[i] = 0.0
                continue
            crop, hit = _silhouette(X_CH, float(self.finger_width_m[i]), cad, _SHARE_PX)
            z = np.maximum((crop.rays()[hit] @ crop.R_CV.T)[:, 2], 0.1)
            # area [px] on the image plane: each pixel times the determinant of the homography's Jacobian
            area = float((self.camera.fx * self.camera.fy / crop.focal**2 / z**3).sum())
            share[i] = min(float(masks[i].sum()) / area, 1.0) if area else 0.0
        return share


def _silhouette(X_CH: Array, width_m: float, cad: GripperCad, size: int) -> tuple[Crop, NDArray[np.bool_]]:
    """Return a crop around the gripper and the pixels (size, size) of it that the gripper covers."""
    crop = Crop.of_gripper(X_CH, _MARGIN, size)
    finger_m = width_m / 2 if np.isfinite(width_m) else 0.02
    surface = cad.cast(invert(crop.X_CV) @ X_CH, crop.rays().reshape(-1, 3), finger_m)
    return crop, surface.part.reshape(size, size) > 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedCase:
    """Planted anomaly of a clip."""

    kind: AnomalyKind
    frame_start: int
    """First affected frame (0-based)."""
    frame_end: int
    """Last affected frame, inclusive."""
    size: float
    """Size in the unit of the kind."""
    form: Annotated[str, BeforeValidator(lambda form: form or "")] = ""
    """Course in time; empty if the kind has a single form."""

    @property
    def anomaly(self) -> Anomaly:
        """The same as an anomaly whose severity is the size."""
        return Anomaly(kind=self.kind, frame_start=self.frame_start, frame_end=self.frame_end, severity=self.size)


@dataclass(frozen=True, slots=True, kw_only=True)
class TruthClipFile:
    """Paths of a video and its ground truth: cheap to send to worker processes."""

    id: str
    task: str
    """Plain task id; empty if the manifest has none."""
    video: Path
    truth: Path
    """One of `TRUTHS`; it may be absent if none is required."""
    camera: Camera
    planted: PlantedCase | None
    """Planted anomaly; None for a clean clip."""
    frame_period_s: float = 0.2
    """Task time between two frames, where the truth has no times [s]."""

    def load(self, *, with_depth: bool = False) -> TruthClip:
        """Read the ground truth; depth maps only if `with_depth`.

        Raises:
            UsageError: the file is damaged, or holds no depth although `with_depth`.
        """
        try:
            with open_npz(self.truth) as truth:
                if with_depth and not {"depth_mm", "mask"} <= set(truth.files):
                    raise UsageError(f"{self.id}: its truth holds no depth; make the videos with --with-depth")
                in_camera = "camera_from_hand" in truth.files
                X_CH = truth["camera_from_hand"] if in_camera else invert(self.camera.X_BC) @ truth["base_from_hand"]
                return TruthClip(
                    id=self.id,
                    task=self.task,
                    path=self.video,
                    camera=self.camera,
                    t_s=np.asarray(truth["t_s"] if "t_s" in truth.files else self._times(len(X_CH)), dtype=np.float64),
                    X_CH=X_CH,
                    finger_width_m=truth["finger_width_m"],
                    depth_m=true_depth(truth) if with_depth else None,
                    mask=true_mask(truth) if "mask" in truth.files else None,
                    faults=() if self.planted is None else (self.planted.anomaly,),
                    visible_px=truth["visible"] if "visible" in truth.files else None,
                )
        except (InputError, KeyError) as error:
            raise UsageError(f"{self.truth.name}: not a readable truth file ({error})") from None

    def _times(self, frames: int) -> Array:
        return self.frame_period_s * np.arange(frames, dtype=np.float64)

    def digest(self) -> str:
        """Return a hash of the video, its camera and its ground truth."""
        digest = blake2b(repr((self.camera.to_json(), self.frame_period_s)).encode(), digest_size=8)
        for path in (self.video, self.truth):
            if path.is_file():
                digest.update(path.read_bytes())
        return digest.hexdigest()


def find_clips(folder: Path, *, required: bool = True) -> list[TruthClipFile]:
    """Return the clips listed in the manifest of a folder, in its order.

    Args:
        folder: folder of videos.
        required: False if clips may lack ground truth.

    Raises:
        UsageError: manifest, camera or ground truth is missing or unusable, or no video is listed.
    """
    manifest = folder / NAME
    if not manifest.is_file():
        raise UsageError(f"{folder.name}: has no {NAME}; make such a folder with `kinebench-drake suite demos`")
    faults = _read_faults(folder / "truth" / "faults.json")
    clips = []
    for line in read_manifest(manifest):
        if line.entry is None:
            raise UsageError(f"{folder.name}/{NAME}: {line.problem}")
        video = folder / line.entry.video
        name = video.stem
        setting = entry_camera(line.entry, folder)
        candidates = [path.format(name) for path in TRUTHS]
        truth = next((folder / path for path in candidates if (folder / path).is_file()), folder / candidates[0])
        if required and not truth.is_file():
            raise UsageError(f"{folder.name}: {candidates[0]} is missing, so errors cannot be measured")
        clips.append(
            TruthClipFile(
                id=name,
                task=line.entry.task or "",
                video=video,
                truth=truth,
                camera=(setting or load_camera(folder / "camera.json")).camera,
                planted=faults.get(name),
                frame_period_s=line.entry.frame_period_s or 0.2,
            )
        )
    return clips


def choose(clips: Sequence[TruthClipFile], limit: int | None) -> list[TruthClipFile]:
    """Return at most `limit` clips, taken from all tasks in turn, in the order of the manifest; all if None."""
    counts: dict[str, int] = {}
    turns = []
    for clip in clips:
        turns.append(counts.get(clip.task, 0))
        counts[clip.task] = turns[-1] + 1
    order = sorted(range(len(clips)), key=lambda i: (turns[i], i))
    return [clips[i] for i in sorted(order[:limit])]


def _read_faults(path: Path) -> dict[str, PlantedCase]:
    """Read the planted anomalies by clip; none if there is no such file."""
    if not path.is_file():
        return {}
    try:
        return TypeAdapter(dict[str, PlantedCase]).validate_json(path.read_bytes())
    except (OSError, ValueError) as error:
        raise UsageError(f"truth/{path.name}: not a readable file of planted anomalies ({cause(error)})") from None
