"""Stages that need no network and no robot: what they do is told by the red of a video's upper left corner.

What is known of a video shows in its track: the median of a given depth is the gripper's distance, the share of the
picture that a given mask covers its confidence.
"""

import os
import signal
import time
from dataclasses import dataclass, field, replace
from enum import IntEnum
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import Camera, CameraSource, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import make_pose
from kinebench_drake.grounding.camera.framing import Framing
from kinebench_drake.grounding.camera.framing_search import find_framing
from kinebench_drake.grounding.priors import NO_PRIORS, InitialStateUse, Priors
from kinebench_drake.kinematics.violation import Violation, ViolationKind
from kinebench_drake.metrics.kinematic_result import KinematicResult
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.track import Domain, GripperTrack, IkStatus, JointTrack

LOG = "FAKE_TOOLS_LOG"
"""Environment variable: file to which every call of `ground` adds a line."""


class Act(IntEnum):
    """What to do with a video; times 40 it is the red of its upper left corner."""

    FEASIBLE = 0
    NO_ROBOT = 1
    RAISE = 2
    DIE = 3
    SLOW = 4
    INFEASIBLE = 5


def act_of(frames):
    return Act(round(float(frames[0, :12, :12, 0].mean()) / 40.0))


@dataclass(frozen=True)
class FakeChoice:
    source: CameraSource
    reason: str | None = None
    agreement: float = 0.7
    contradiction: object = None
    table_height_m: float | None = None

    def to_json(self):
        state = "none" if self.reason else "named" if self.source.is_named else "confirmed"
        data = {"camera_source": "none" if state == "none" else self.source.value, "camera_state": state}
        data["camera_agreement"] = self.agreement
        return data | ({} if self.reason is None else {"base_frame_reason": self.reason})


@dataclass(frozen=True)
class FakeResult:
    track: GripperTrack
    anomalies: tuple[Anomaly, ...]
    frames: np.ndarray
    camera: Camera
    framing: Framing
    choice: FakeChoice
    table_height_m: float | None
    camera_motion_px: float | None = 0.12
    arm_consistency_px: float | None = 2.0
    first_frame: InitialStateUse = InitialStateUse.UNKNOWN
    domain: Domain = Domain.FAMILIAR
    gripper: GripperKind = GripperKind.FRANKA
    curves: dict[str, np.ndarray] = field(default_factory=dict)
    camera_path: None = None
    anomalies_not_looked_for: tuple[AnomalyKind, ...] = ()
    anomalies_open: tuple[AnomalyKind, ...] = ()
    detections: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(scores={}))
    hand_size: None = None
    possible: tuple[GripperTrack, ...] = ()

    @property
    def measured(self):
        return self

    @property
    def robot(self):
        return np.zeros(self.frames.shape[:3], bool)

    @property
    def visible_track(self):
        return self.track

    @property
    def unmeasurable(self):
        return None if self.track.tracked.sum() > 1 else "a gripper is seen, but trusted in 0"


class FakeGrounder:
    """Grounding that reads its track from the frames; an unnamed camera is the benchmark's where the shape fits."""

    infeasible = False

    def ground(
        self,
        clip,
        camera=None,
        priors=NO_PRIORS,
        *,
        source=CameraSource.ARGUMENT,
        table_height_m=None,
        gripper=GripperKind.AUTO,
        trusts_camera=False,
    ):
        act = act_of(clip.frames)
        if LOG in os.environ:
            with Path(os.environ[LOG]).open("a") as log:
                log.write(f"{act.name} {os.getpid()}\n")
        named = camera is not None or trusts_camera
        lens = camera or benchmark_camera()
        choice = FakeChoice(source if named else CameraSource.BENCHMARK, table_height_m=table_height_m)
        try:
            framing = find_framing(clip.frames, lens, clip.conditioning, choice.source)
        except UnmeasurableError:
            if named:
                raise
            choice = replace(
                choice,
                reason="the base frame is unknown: no camera is named, the shape of the video differs, nothing fits",
            )
            lens = replace(lens, width=clip.frames.shape[2], height=clip.frames.shape[1])
            framing = find_framing(clip.frames, lens, None)
        if act is Act.RAISE:
            raise RuntimeError("the fake\nfell over")
        if act is Act.DIE:
            os.kill(os.getpid(), signal.SIGKILL)
        if act is Act.SLOW:
            time.sleep(0.4)
        if not isinstance(priors, Priors):
            priors = priors(framing.whole_camera(lens))
        track, anomalies = self.track(clip, priors)
        if choice.reason is not None:
            track = replace(track, X_BG=np.full_like(track.X_BG, np.nan))
        if not track.tracked.any() and not trusts_camera:
            raise UnmeasurableError(f"no Franka hand is found in any of {len(clip.frames)} frames")
        return self.result(
            FakeResult(
                track=track,
                anomalies=anomalies,
                frames=framing.crop(clip.frames),
                camera=framing.camera(lens),
                framing=framing,
                choice=choice,
                table_height_m=table_height_m,
            )
        )

    def result(self, result):
        """What subclasses change."""
        return result

    def track(self, clip, known):
        act = act_of(clip.frames)
        t_s = clip.t_s
        self.infeasible = act is Act.INFEASIBLE
        n = len(t_s)
        s = np.linspace(0.0, 1.0, n)
        p = np.stack([0.4 + 0.1 * s, 0.2 * np.sin(3 * s), 0.3 + 0.05 * np.cos(5 * s)], axis=1)
        X = make_pose(np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (n, 3, 3)), p)
        X = X if known.X_CH is None else known.X_CH.copy()
        if known.depth is not None:
            X[:, 2, 3] = np.median(known.depth.depth_m, axis=(1, 2))
        if known.initial_state is not None:
            X[0] = known.initial_state.X_BG
        tracked = np.isfinite(X).all(axis=(1, 2))
        anomalies = ()
        if act is Act.NO_ROBOT:
            tracked[:] = False
        if self.infeasible:
            tracked[n // 2 : n // 2 + 2] = False
            anomalies = (Anomaly(kind=AnomalyKind.VANISH, frame_start=n // 2, frame_end=n // 2 + 1, severity=2.0),)
        X[~tracked] = np.nan
        confidence = np.where(tracked, 0.95 - 0.3 * np.sin(np.pi * s) ** 2, 0.0)
        confidence = confidence if known.mask is None else known.mask.mean(axis=(1, 2))
        width = 0.04 + 0.03 * np.cos(4 * s) if known.finger_width_m is None else known.finger_width_m
        track = GripperTrack(
            t_s=t_s,
            X_CH=X,
            X_BG=X,
            tracked=tracked,
            confidence=confidence,
            finger_width_m=np.where(tracked, width, np.nan),
        )
        return track, anomalies


class FakeTools:
    make_grounder = FakeGrounder

    def __init__(self, options):
        self._options = options
        self.grounder = self.make_grounder()
        self._infeasible = False

    def judge(self, track, table_height_m=None):
        n = len(track.t_s)
        infeasible = self._infeasible or self.grounder.infeasible
        q = np.linspace(-0.5, 0.5, n)[:, None] * np.ones(7)
        q[~track.tracked] = np.nan
        joints = JointTrack(
            t_s=track.t_s,
            q=q,
            status=tuple(IkStatus.OK if t else IkStatus.NOT_TRACKED for t in track.tracked),
            position_error_m=np.where(track.tracked, 1e-6, np.nan),
            rotation_error_rad=np.where(track.tracked, 1e-6, np.nan),
        )
        speed = float(np.abs(np.diff(track.t_s)).mean())
        violation = Violation(
            kind=ViolationKind.VELOCITY,
            frame_start=3,
            frame_end=5,
            joint="panda_joint2",
            value=1.7,
            limit=1.0,
            unit="rad/s",
        )
        return KinematicResult(
            track=track,
            joints=joints,
            feasible=not infeasible,
            metrics={"sparc": -1.6 - speed, "ik_success_rate": 1.0, "trajopt_feasible": True, "ldlj": float("nan")},
            violations=(violation,) if infeasible else (),
            reasons={"ldlj": "the fake has none"},
            details={"table_height_m": self._options.table_height_m if table_height_m is None else table_height_m},
            curves={
                "bridged": np.zeros(n),
                "manipulability": 0.05 + 0.02 * np.cos(q[:, 0] * 5),
                "joint_margin": 0.4 - q[:, 0] ** 2,
            },
        )

    def judge_joints(self, t_s, q, finger_width_m):
        """Infeasible where the first joint starts beyond 1 rad."""
        known = np.isfinite(q).all(axis=1)
        X = np.where(known[:, None, None], make_pose(np.eye(3), np.nan_to_num(q[:, :3])), np.nan)
        track = GripperTrack(
            t_s=t_s,
            X_CH=np.full_like(X, np.nan),
            X_BG=X,
            tracked=known,
            confidence=known.astype(float),
            finger_width_m=finger_width_m,
        )
        self._infeasible = bool(q[0, 0] > 1.0)
        judgement = self.judge(track)
        self._infeasible = False
        return replace(judgement, joints=replace(judgement.joints, q=q), details={"given": "q"})

    def misfit(self, trajectory, enough):
        return 0.0

    def overlay(self, frames, camera, track, zoom=None, *, hand=True):
        for frame, X in zip(frames, track.X_BG, strict=True):
            image = frame.copy()
            if np.isfinite(X).all():
                u = int(np.clip((X[0, 3] - 0.35) / 0.2, 0, 0.9) * image.shape[1])
                image[image.shape[0] // 2 :, u : u + 6] = [255, 220, 0]
            yield image


def broken(options):
    """A factory of analyzers on a machine that lacks a library."""
    raise ImportError("libmissing.so: cannot open shared object file")
