"""Recognition of the camera of a video among those that are known by name: with which does the arm agree, and clearly?

The robot is detected once for each way in which a picture may be turned; its cells say which cameras come into
question, contours decide between them. No camera is estimated.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.candidate import CameraCandidate
from kinebench_drake.grounding.camera.check import SEARCHED, CameraChecker
from kinebench_drake.grounding.camera.estimate import usual_camera
from kinebench_drake.grounding.camera.evidence import BetterReading, PictureReading
from kinebench_drake.grounding.camera.framing import placements
from kinebench_drake.grounding.camera.lens import Lens
from kinebench_drake.io.frames import Frames
from kinebench_drake.named_cameras import BENCHMARK, NamedCamera, named_cameras
from kinebench_drake.segments import evenly

# Checked on clips at stock cameras: `benchmarks/mujoco_clips.py stock`, then
# `python -m benchmarks cameras stock --out OUT --presented plain`.
RECOGNITION_LEAD = 0.05
"""Least lead of a camera known by name in the agreements of arm and base together.

Also how much more of the arm's agreement a camera may have that is freed from its place."""
_LIKELY_COST = 6.0
"""Greatest mean error of the cells (`Hypothesis.cost`) of a named camera that comes into question."""
_LIKELY_COST_LEAD = 0.8
"""Greatest difference of this error from that of the best named camera."""
_FITTED = 5
"""Cameras that are fitted to contours."""
_SAME = 0.3
"""Factor of the tolerances of `Lens.sees_same_arm` within which two pictures are the same."""
_MARGIN = 0.05
"""Share of the sides of a picture by which the foot of the robot may lie outside."""
_TURNS = (
    PictureReading.MIRRORED,
    PictureReading.ROWS_REVERSED,
    PictureReading.UPSIDE_DOWN,
    PictureReading.TURNED_LEFT,
    PictureReading.TURNED_RIGHT,
)
"""Other ways to read a picture; those by which it is not published are tried with the benchmark camera alone."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recognition:
    """Named camera with which the arm agrees better than with any other."""

    named: NamedCamera
    camera: Camera
    """Camera of the frames as read."""
    reading: PictureReading | None
    """How the frames have to be read; None: as they are."""
    agreement: float
    """Share of the contours of hand and arm on image edges."""
    base_agreement: float
    """The same of the base link; 0 if it is not seen."""
    lead: float
    """Lead of their sum over that of the next camera with another picture."""
    freed: float
    """Agreement of a camera freed from its place."""

    @property
    def is_clear(self) -> bool:
        """True if the arm confirms it, and no other."""
        return (
            self.agreement >= bounds.AGREEMENT
            and self.base_agreement >= bounds.BASE_AGREEMENT
            and self.lead >= RECOGNITION_LEAD
            and self.freed <= self.agreement + RECOGNITION_LEAD
        )

    @property
    def is_usual(self) -> bool:
        """True if pictures of this camera are published so."""
        return self.reading is None or self.reading.value in self.named.presented

    def as_better_reading(self, agreement: float) -> BetterReading:
        """Return the reading of a picture that is not published so, whose agreement as it is was `agreement`."""
        assert self.reading is not None
        return BetterReading(reading=self.reading, agreement=agreement, better=self.agreement, camera=self.camera)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Trial:
    """Camera that comes into question, with the robot's postures fitted to it."""

    named: NamedCamera
    reading: PictureReading | None
    frames: Frames
    """(T, H, W, 3) those of the fit, as read."""
    fit: CameraCandidate
    base_agreement: float

    @property
    def score(self) -> float:
        return self.fit.agreement + self.base_agreement

    def is_same(self, other: "_Trial") -> bool:
        """Return whether another one has practically the same picture."""
        return self.reading is other.reading and self.fit.scene.lens.sees_same_arm(other.fit.scene.lens, _SAME)


def recognize(frames: Frames, checker: CameraChecker) -> Recognition | None:
    """Return the named camera of frames (T, H, W, 3), as they are or read in another way; None if none is clear."""
    trials: list[_Trial] = []
    best: Recognition | None = None
    frames = np.asarray(frames[evenly(len(frames), SEARCHED)])
    for reading in (None, *_TURNS):
        names = [
            named
            for named in named_cameras().values()
            if reading is None or reading.value in named.presented or named.name == BENCHMARK
        ]
        if best is not None and best.is_clear:  # seen from ahead an arm looks much the same in a mirror, no other way
            names = [best.named] if reading is PictureReading.MIRRORED else []
        own = _trials(reading, names, frames, checker) if names else []
        if own:
            trials += own
            best = _best(trials, checker)
    return best if best is not None and best.is_clear else None


def _best(trials: Sequence[_Trial], checker: CameraChecker) -> Recognition:
    """Return the camera of the best trial, compared with those that have another picture."""
    best = max(trials, key=lambda trial: trial.score)
    return Recognition(
        named=best.named,
        camera=best.fit.scene.lens.to_camera(),
        reading=best.reading,
        agreement=best.fit.agreement,
        base_agreement=best.base_agreement,
        lead=best.score - max((trial.score for trial in trials if not trial.is_same(best)), default=0.0),
        freed=checker.freed_agreement(best.frames, best.fit),
    )


def _trials(
    reading: PictureReading | None, names: Sequence[NamedCamera], frames: Frames, checker: CameraChecker
) -> list[_Trial]:
    """Return the cameras that come into question for frames (T, H, W, 3), read in one way."""
    frames = frames if reading is None else reading.frames(frames)
    height, width = frames.shape[1:3]
    detections = checker.detect(frames, usual_camera(width, height))
    if detections is None:
        return []
    tried = [(named, camera) for named in names for camera in cameras_of(named, width, height)]
    explained = [(checker.explain(detections, camera), named) for named, camera in tried]
    explained.sort(key=lambda one: one[0].cost)
    trials = []
    for hypothesis, named in explained[:_FITTED]:
        likely = hypothesis.cost <= min(_LIKELY_COST, explained[0][0].cost + _LIKELY_COST_LEAD)
        fit = checker.fit_postures(detections, frames, hypothesis) if likely else None
        if fit is not None:
            own = frames[detections.rows[fit.rows]]
            base = checker.base_agreement(own, fit)
            trials.append(_Trial(named=named, reading=reading, frames=own, fit=fit, base_agreement=base))
    return trials


def cameras_of(named: NamedCamera, width: int, height: int) -> Iterator[Camera]:
    """Yield the cameras of pictures of `width` x `height` that a named camera takes, and that show the robot's foot.

    Its picture scaled; of another shape: rendered at that shape with the same vertical field of view, or scaled and cut
    to its middle or to its upper or left part.
    """
    camera = named.setting.camera
    framings = placements((camera.width, camera.height), (width, height))
    pictures = [framings[0].whole_camera(camera)]
    if len(framings) > 1:
        focal = camera.fy * height / camera.height
        rendered = replace(camera, width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2)
        centred, first, _ = framings[-3:]
        pictures = [rendered, centred.whole_camera(camera), first.whole_camera(camera)]
    for own in pictures:
        foot_C = Lens.of_camera(own).X_CB[:3, 3]
        off_centre = np.abs(own.project(foot_C) / [width, height] - 0.5)
        if foot_C[2] > 0 and bool((off_centre <= 0.5 + _MARGIN).all()):
            yield own
