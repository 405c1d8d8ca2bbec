"""Wrong focal lengths and right ones, given as the camera of a video: how often the check by the arm notices them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from benchmarks.markdown import table
from kinebench_drake.calibration.fit import with_focal
from kinebench_drake.datasets.videos.sample import CameraSource, VideoSample
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.evaluation.analyzer import Analyzer, RobotOptions
from kinebench_drake.evaluation.grounding import ground_with_camera
from kinebench_drake.grounding.evaluation.clip import TruthClipFile, choose, find_clips
from kinebench_drake.grounding.evaluation.store import MeasurementStore, fingerprint
from kinebench_drake.grounding.overrides.overrides import Overrides
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.reader import read_video
from kinebench_drake.types import GripperKind


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalTrial:
    """Check of the camera of one video whose focal length is multiplied by a factor."""

    id: str
    factor: float
    """Focal length of the camera over the true one."""
    tracked: float | None
    """Share of tracked frames; None where the video is unmeasurable."""
    agreement: float | None
    """`camera_agreement` of the row."""
    contradiction: dict[str, float] | None
    """`camera_contradiction` of the row."""
    reason: str | None
    """Why there are no verdicts."""

    @property
    def is_noticed(self) -> bool:
        """Whether the row says that the arm contradicts the camera."""
        return self.contradiction is not None or "the arm contradicts" in (self.reason or "")

    def to_json(self) -> dict[str, Any]:
        """Return the JSON object."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> "FocalTrial":
        """Read the object that `to_json` returns."""
        return cls(**data)


def try_focal(clip: TruthClipFile, factor: float, analyzer: Analyzer) -> FocalTrial:
    """Ground a video with a wrong focal length, as `score` does."""
    camera = with_focal(clip.camera, factor * clip.camera.fx)
    sample = VideoSample(
        id=clip.id, path=clip.video, video=clip.video.name, camera=camera, camera_source=CameraSource.MANIFEST
    )
    try:
        grounded = ground_with_camera(read_video(clip.video), sample, Overrides(), analyzer, gripper=GripperKind.FRANKA)
    except UnmeasurableError as error:
        return FocalTrial(
            id=clip.id, factor=factor, tracked=None, agreement=None, contradiction=None, reason=str(error)
        )
    choice, grounding = grounded.choice, grounded.grounding
    other = choice.contradiction
    return FocalTrial(
        id=clip.id,
        factor=factor,
        tracked=round(float(grounding.track.tracked.mean()), 3),
        agreement=choice.agreement,
        contradiction=None if other is None else {k: float(getattr(other, k)) for k in other.__slots__},
        reason=choice.reason,
    )


def measure(folder: Path, out: Path, factors: Sequence[float], *, limit: int | None, log: Callable[[str], None]) -> str:
    """Check the cameras of a folder of videos with their focal lengths multiplied, write focal.md, and return it.

    Args:
        folder: videos of `suite demos` or `perception render`, or with a manifest and truths like theirs.
        out: output folder; finished checks are kept.
        factors: focal lengths over the true ones; 1 for the right camera.
        limit: number of videos, tasks in turn; all if None.
        log: receives a line per check.

    Raises:
        UsageError: the folder has no such videos.
    """
    clips = choose(find_clips(folder), limit)
    make_folder(out)
    base = fingerprint(modules=["kinebench_drake.evaluation.grounding"])
    store = MeasurementStore(out / "focal.jsonl", FocalTrial)
    analyzer, trials = Analyzer(RobotOptions()), []
    for clip in clips:
        for factor in factors:
            key = f"{base}-{clip.digest()}-{clip.id}-{factor:g}"
            if key not in store:
                store.put(key, try_focal(clip, factor, analyzer))
                log(f"{clip.id} x {factor:g}: {'noticed' if store[key].is_noticed else 'not noticed'}")
            trials.append(store[key])
    text = "\n".join([*focal_table(trials), "", *_rows(trials)]) + "\n"
    write_atomically(out / "focal.md", text.encode())
    return text


def focal_table(trials: Sequence[FocalTrial]) -> list[str]:
    """Return a row for each factor: how often the camera is contradicted, confirmed, and judged."""
    rows = []
    for factor in sorted({t.factor for t in trials}):
        own = [t for t in trials if t.factor == factor]
        rows.append(
            [
                f"{factor:g}",
                str(len(own)),
                str(sum(t.is_noticed for t in own)),
                str(sum(t.reason is None for t in own)),
                str(sum(t.tracked is None for t in own)),
            ]
        )
    return table(("focal length over the true one", "videos", "contradicted", "judged", "unmeasurable"), rows)


def _rows(trials: Sequence[FocalTrial]) -> list[str]:
    rows = []
    for t in trials:
        c = t.contradiction
        rows.append(
            [
                f"{t.id} x {t.factor:g}",
                *("" if v is None else f"{v:.2f}" for v in (t.tracked, t.agreement)),
                *(["", "", ""] if c is None else _contradiction_cells(c)),
                t.reason or "",
            ]
        )
    return table(("video", "tracked", "agreement", "better", "ratio", "gripper [mm]", "no verdicts since"), rows)


def _contradiction_cells(c: dict[str, float]) -> list[str]:
    return [f"{c['agreement']:.2f} / {c['better']:.2f}", f"{c['focal_ratio']:.2f}", f"{1e3 * c['gripper_m']:.0f}"]
