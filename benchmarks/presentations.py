"""Videos with known poses, presented rightly and wrongly: which get a base frame, and how far off it is.

The gate presents short clips of several programs, of which none may be silently wrong.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

import numpy as np

from benchmarks.markdown import table
from benchmarks.perception.clip import TruthClipFile, find_clips
from benchmarks.perception.store import MeasurementStore, fingerprint
from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.executors.base import Executor, Observer
from kinebench_drake.geometry import pose_difference
from kinebench_drake.grounding.camera.evidence import PictureReading
from kinebench_drake.grounding.camera.lens import with_focal
from kinebench_drake.grounding.priors import Clip
from kinebench_drake.grounding.video import Grounder
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.reader import read_video
from kinebench_drake.models.panda.description import hand_from_tcp

WRONG_M = 0.03
WRONG_RAD = np.deg2rad(15.0)
"""Median errors of the TCP in the base frame beyond which it is wrong."""
RIGHT_M = 0.02
RIGHT_RAD = np.deg2rad(5.0)
"""Median errors up to which it is right."""
_SAME_M = 0.005
"""Distance of a recognized camera from the true one beyond which it is another [m]."""
_MIDDLE = 0.875
_CORNER = 0.9
"""Sides of a cropped picture over those of the whole one."""


class Presentation(Enum):
    """How a video is presented to the grounding."""

    NAMED = "named"
    """With its camera."""
    PLAIN = "plain"
    """Without a camera."""
    MIRRORED = "mirrored"
    ROWS_REVERSED = "rows_reversed"
    """As MuJoCo's raw images are."""
    UPSIDE_DOWN = "upside_down"
    TURNED = "turned"
    """By 90 degrees to the left."""
    MIDDLE = "middle"
    """Cropped to its middle."""
    CORNER = "corner"
    """Cropped to its upper right."""
    NAMED_MIRRORED = "named_mirrored"
    """Mirrored, with the camera of the picture that is not."""
    NAMED_MIDDLE = "named_middle"
    """Cropped to its middle, with the camera of the whole picture."""
    OPENGL_AXES = "opengl_axes"
    """With its camera, the axes as in OpenGL."""
    INVERTED = "inverted"
    """With its camera, the matrix inverted."""
    SHORT_FOCAL = "short_focal"
    """With its camera, 0.7 of the focal length."""
    LONG_FOCAL = "long_focal"
    """With its camera, 1.4 times the focal length."""

    @property
    def names_camera(self) -> bool:
        """True if the video comes with a camera."""
        return self.value.startswith("named") or self in _MATRICES or self in _FOCALS

    def apply(self, frames: Frames, camera: Camera) -> tuple[Frames, Camera]:
        """Return frames (T, H, W, 3) and camera as presented."""
        height, width = frames.shape[1:3]
        if self in _PICTURES:
            return _PICTURES[self].frames(frames), camera
        if self in _MATRICES:
            return frames, _MATRICES[self].camera(camera)
        if self in _FOCALS:
            return frames, with_focal(camera, _FOCALS[self] * camera.fx)
        if self is Presentation.CORNER:
            rows = round(_CORNER * height)
            columns = round(_CORNER * width)
            return np.ascontiguousarray(frames[:, :rows, width - columns :]), camera
        if self in (Presentation.MIDDLE, Presentation.NAMED_MIDDLE):
            top = round((1 - _MIDDLE) / 2 * height)
            left = round((1 - _MIDDLE) / 2 * width)
            return np.ascontiguousarray(frames[:, top : height - top, left : width - left]), camera
        return frames, camera


_PICTURES = {
    Presentation.MIRRORED: PictureReading.MIRRORED,
    Presentation.NAMED_MIRRORED: PictureReading.MIRRORED,
    Presentation.ROWS_REVERSED: PictureReading.ROWS_REVERSED,
    Presentation.UPSIDE_DOWN: PictureReading.UPSIDE_DOWN,
    Presentation.TURNED: PictureReading.TURNED_LEFT,
}
_MATRICES = {Presentation.OPENGL_AXES: PictureReading.OPENGL_AXES, Presentation.INVERTED: PictureReading.INVERTED}
_FOCALS = {Presentation.SHORT_FOCAL: 0.7, Presentation.LONG_FOCAL: 1.4}


class Verdict(Enum):
    """Result of a presented video."""

    RIGHT = "right"
    """There are base-frame poses, and they are right."""
    NEAR = "near"
    """They are between right and wrong."""
    WRONG = "wrong"
    """They are wrong, and nothing says so."""
    WITHHELD = "withheld"
    """There are none, with a reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """One video, presented in one way."""

    clip: TruthClipFile
    presentation: Presentation


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the grounding makes of a trial."""

    id: str
    presentation: str
    state: str
    """How the camera is known; "none" without a base frame."""
    reason: str | None = None
    """Why there is no base frame, or no track."""
    agreement: float | None = None
    reading: str | None = None
    name: str | None = None
    """Name of the camera that was recognized."""
    tracked: float = 0.0
    """Share of the frames."""
    position_m: float | None = None
    """Median distance of the tracked from the true TCPs in the base frame [m]; None without a base frame."""
    rotation_rad: float | None = None
    """Likewise of their rotations [rad]."""
    camera_m: float | None = None
    """Distance of an estimated or recognized camera from the true one [m]; None without one."""
    camera_sigma_m: float | None = None
    cpu_s: float
    """Processor time [s]."""

    @property
    def verdict(self) -> Verdict:
        """Result of the video."""
        if self.position_m is None or self.rotation_rad is None:
            return Verdict.WITHHELD
        if self.position_m > WRONG_M or self.rotation_rad > WRONG_RAD:
            return Verdict.WRONG
        return Verdict.RIGHT if self.position_m <= RIGHT_M and self.rotation_rad <= RIGHT_RAD else Verdict.NEAR


class TrialWorker:
    """Grounds trials."""

    def __init__(self) -> None:
        """Create the grounding."""
        self._grounder = Grounder()

    def __call__(self, trial: Trial) -> Outcome:
        """Ground a trial and compare its track with the truth."""
        clip = trial.clip
        presentation = trial.presentation
        truth = clip.load()
        video = read_video(clip.video)
        frames, camera = presentation.apply(video.frames, clip.camera.resized(video.width, video.height))
        start = time.process_time()
        base = Outcome(id=clip.id, presentation=presentation.value, state="none", cpu_s=0.0)
        try:
            result = self._grounder.ground(
                Clip(frames=frames, t_s=truth.t_s), camera if presentation.names_camera else None
            )
        except UnmeasurableError as error:
            return replace(base, reason=str(error), cpu_s=round(time.process_time() - start, 2))
        choice = result.choice
        track = result.track
        position_m, rotation_rad = pose_difference(track.X_BG, clip.camera.X_BC @ truth.X_CH @ hand_from_tcp())
        compared = track.tracked & np.isfinite(position_m)
        estimate = choice.estimate
        distance_m, _ = pose_difference(choice.camera.X_BC, clip.camera.X_BC)
        return replace(
            base,
            state=choice.state.value,
            reason=choice.reason or result.unmeasurable,
            agreement=choice.agreement,
            reading=None if choice.better_reading is None else choice.better_reading.reading.value,
            name=None if choice.named is None else choice.named.name,
            tracked=round(float(track.tracked.mean()), 4),
            position_m=float(np.median(position_m[compared])) if compared.any() else None,
            rotation_rad=float(np.median(rotation_rad[compared])) if compared.any() else None,
            camera_m=None if estimate is None and choice.named is None else float(distance_m),
            camera_sigma_m=None if estimate is None else estimate.position_sigma_m,
            cpu_s=round(time.process_time() - start, 2),
        )


def measure(trials: Sequence[Trial], executor: Executor, observer: Observer, keep: Path | None = None) -> list[Outcome]:
    """Ground trials, in their order; the same call goes on from the file of finished outcomes, `keep`."""
    base = fingerprint(modules=["kinebench_drake.grounding.video"])

    def key(trial: Trial) -> str:
        return f"{base}-{trial.clip.digest()}-{trial.clip.id}-{trial.presentation.value}"

    store = MeasurementStore(keep, Outcome)
    return store.complete(trials, key, executor, TrialWorker, observer, lambda t: f"{t.clip.id} {t.presentation.value}")


def summary_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a row for each presentation: how many videos became what, and the errors where there is a base frame."""
    rows = []
    for presentation in Presentation:
        own = [o for o in outcomes if o.presentation == presentation.value]
        if not own:
            continue
        based = [o for o in own if o.position_m is not None]
        error = f"{1e3 * np.median([o.position_m for o in based if o.position_m is not None]):.1f}" if based else "-"
        turn = (
            f"{np.rad2deg(np.median([o.rotation_rad for o in based if o.rotation_rad is not None])):.1f}"
            if based
            else "-"
        )
        counts = [str(sum(o.verdict is verdict for o in own)) for verdict in Verdict]
        recognized = [o for o in own if o.name is not None]
        another = sum((o.camera_m or 0.0) > _SAME_M for o in recognized)
        named = [f"{len(recognized)} ({another})", str(sum(o.reading is not None for o in own))]
        cpu = f"{np.median([o.cpu_s for o in own]):.0f}"
        rows.append([presentation.value.replace("_", " "), str(len(own)), *counts, *named, error, turn, cpu])
    head = (
        "presented",
        "videos",
        *(v.value for v in Verdict),
        "recognized (another)",
        "reading named",
        "TCP [mm]",
        "[degrees]",
        "time [s]",
    )
    return table(head, rows)


def outcome_table(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a row for each outcome."""

    def number(value: float | None, scale: float = 1.0, digits: int = 0) -> str:
        return "" if value is None else f"{scale * value:.{digits}f}"

    rows = [
        [
            o.id,
            o.presentation.replace("_", " "),
            o.verdict.value,
            o.state if o.name is None else f"{o.state} {o.name}",
            number(o.agreement, digits=2),
            f"{o.tracked:.0%}",
            number(o.position_m, 1e3, 1),
            number(o.rotation_rad, np.rad2deg(1.0), 1),
            f"{number(o.camera_m, 1e3)} ({number(o.camera_sigma_m, 1e3)})" if o.camera_m is not None else "",
            o.reason or "",
        ]
        for o in outcomes
    ]
    head = ("video", "presented", "verdict", "camera", "agreement", "tracked", "TCP [mm]", "[degrees]")
    return table((*head, "estimated camera: error (sigma) [mm]", "reason"), rows)


CLIPS = Path("tests/gate")
"""Folder of the clips, each with its truth, and of their bounds."""
CLIPS_VARIABLE = "KINEBENCH_GATE_CLIPS"
"""Environment variable with a further folder, whose clips must not be wrong however they are presented."""
_EXTRA = (Presentation.NAMED, Presentation.PLAIN, Presentation.MIRRORED)


def find_trials(folder: Path, extra: Path | None) -> tuple[list[Trial], dict[tuple[str, str], str]]:
    """Return the trials of the gate, and the verdict that each must have; "" for any but wrong.

    Args:
        folder: clips, and `bounds.json`: by clip and presentation the verdict, or the reading that must be named.
        extra: a further folder of clips; None: none.

    Raises:
        UsageError: a folder has no clips with truth.
    """
    bounds = json.loads((folder / "bounds.json").read_text())
    trials = []
    expected = {}
    for clip in find_clips(folder):
        for name, verdict in bounds[clip.id].items():
            trials.append(Trial(clip=clip, presentation=Presentation(name)))
            expected[clip.id, name] = verdict
    for clip in find_clips(extra) if extra is not None else ():
        trials += [Trial(clip=clip, presentation=presentation) for presentation in _EXTRA]
    return trials, expected


def check_outcomes(outcomes: Sequence[Outcome], expected: dict[tuple[str, str], str]) -> list[str]:
    """Return a line for each outcome that does not hold: wrong, or not the expected verdict or reading."""
    faults = []
    for outcome in outcomes:
        wanted = expected.get((outcome.id, outcome.presentation), "")
        name = f"{outcome.id}, {outcome.presentation.replace('_', ' ')}"
        if outcome.verdict is Verdict.WRONG and outcome.position_m is not None:
            faults.append(f"{name}: silently wrong by {1e3 * outcome.position_m:.0f} mm (camera {outcome.state})")
        elif wanted and wanted not in (outcome.verdict.value, outcome.reading):
            faults.append(f"{name}: {outcome.verdict.value}, expected {wanted}: {outcome.reason or 'no reason'}")
    return faults


def run_gate(folder: Path, extra: Path | None, executor: Executor, observer: Observer) -> list[str]:
    """Ground the clips of the gate and return what does not hold; see `find_trials` and `check_outcomes`."""
    trials, expected = find_trials(folder, extra)
    return check_outcomes(measure(trials, executor, observer), expected)
