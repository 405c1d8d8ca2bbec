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

import numpy as np

from kinebench_drake.errors import InputError, UnmeasurableError
from kinebench_drake.geometry import make_pose
from kinebench_drake.metrics.result import KinematicResult
from kinebench_drake.types import (
    Anomaly,
    AnomalyKind,
    Domain,
    GripperKind,
    GripperTrack,
    IkStatus,
    InitialStateUse,
    JointTrack,
    Violation,
    ViolationKind,
)

LOG = "FAKE_ANALYZER_LOG"
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
class FakeGrounding:
    track: GripperTrack
    anomalies: tuple[Anomaly, ...]
    camera_motion_px: float | None
    arm_q: np.ndarray
    arm_consistency_px: float | None = 2.0
    first_frame: InitialStateUse = InitialStateUse.UNKNOWN
    domain: Domain = Domain.FAMILIAR
    gripper: GripperKind = GripperKind.FRANKA
    curves: dict[str, np.ndarray] = field(default_factory=dict)
    camera_path: None = None

    @property
    def X_CH_raw(self):
        return self.track.X_CH

    @property
    def has_pose(self):
        return np.isfinite(self.track.X_CH).all(axis=(1, 2))


class FakeAnalyzer:
    def __init__(self, options):
        if options.tcp_frame == "nowhere":
            raise InputError("arm.urdf has no frame nowhere")
        self._options = options
        self._infeasible = False

    def ground(self, frames, camera, t_s, known):
        act = act_of(frames)
        if LOG in os.environ:
            with Path(os.environ[LOG]).open("a") as log:
                log.write(f"{act.name} {os.getpid()}\n")
        return self.ground_arm(frames, camera, t_s, known)

    def ground_arm(self, frames, camera, t_s, known, gripper=GripperKind.NONE):
        act = act_of(frames)
        if act is Act.RAISE:
            raise RuntimeError("the fake\nfell over")
        if act is Act.DIE:
            os.kill(os.getpid(), signal.SIGKILL)
        if act is Act.SLOW:
            time.sleep(0.4)
        self._infeasible = act is Act.INFEASIBLE
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
        if self._infeasible:
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
        return FakeGrounding(track, anomalies, 0.12, np.zeros((n, 7)))

    def camera_agreement(self, frames, camera):
        return 0.7

    def estimate_camera(self, frames):
        raise UnmeasurableError("no camera can be estimated: a gripper is seen in 0 of the frames searched")

    def posture_agreement(self, frames, camera, q, finger_m, *, hand):
        return 0.7

    def camera_contradiction(self, frames, camera):
        return None

    def camera_reading(self, frames, camera, least, *, likely_only):
        return None

    def count_hands(self, frames):
        return (0 if act_of(frames) is Act.NO_ROBOT else len(frames)), len(frames)

    def judge(self, track, table_height_m=None):
        n = len(track.t_s)
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
            kind=ViolationKind.VELOCITY, frame_start=3, frame_end=5, joint="panda_joint2", value=1.7, limit=1.0
        )
        return KinematicResult(
            track=track,
            joints=joints,
            feasible=not self._infeasible,
            metrics={"sparc": -1.6 - speed, "ik_success_rate": 1.0, "trajopt_feasible": True, "ldlj": float("nan")},
            violations=(violation,) if self._infeasible else (),
            reasons={"ldlj": "the fake has none"},
            details={"table_height_m": self._options.table_height_m if table_height_m is None else table_height_m},
            curves={"manipulability": 0.05 + 0.02 * np.cos(q[:, 0] * 5), "joint_margin": 0.4 - q[:, 0] ** 2},
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
