"""Stages that need no network and no robot: what they do with a film the test says when it writes it (`Behavior`).

Priors show in the track: the median of a given depth is the gripper's distance, the share of the picture that a given
mask covers its confidence.
"""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import Camera, CameraSource, benchmark_camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import make_pose
from kinebench_drake.grounding.camera.framing import Framing, find_framing
from kinebench_drake.grounding.panels.content import list_panels
from kinebench_drake.grounding.priors import NO_PRIORS, InitialStateUse, Priors
from kinebench_drake.metrics.kinematic_result import KinematicResult
from kinebench_drake.models.panda.description import GripperKind
from kinebench_drake.track import Domain, GripperTrack, IkStatus, JointTrack
from kinebench_drake.violation import Violation, ViolationKind
from tests.fakes.behavior import Fakes

REACH_M = 1.0
"""Greatest x in the base frame that the fake arm reaches."""
VANISH = 2
"""Frames for which a gripper that vanishes is absent."""


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
    gripper_model: None = None
    lost_frames: tuple[object, ...] = ()
    panels: object = None
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


class FakeEstimator:
    """Estimates by which bright pixels are the arm."""

    def estimate(self, frames, camera, crops):
        for k in crops:
            yield k, SimpleNamespace(arm=frames[k].mean(axis=2) > 128, in_image=np.ones(frames.shape[1:3], bool))


class FakeGrounder:
    """Grounding that makes its track up; an unnamed camera is the benchmark's where the shape fits."""

    def list_panels(self, frames, tiles):
        return list_panels(frames, tiles, FakeEstimator())

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
        stride=1,
        watch=None,
    ):
        fakes = Fakes.of_environment()
        fakes.note_call()
        behavior = fakes.behavior(clip.frames)
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
        behavior.act()
        if not isinstance(priors, Priors):
            priors = priors(framing.whole_camera(lens))
        track, anomalies = make_track(clip, priors, behavior)
        if choice.reason is not None:
            track = replace(track, X_BG=np.full_like(track.X_BG, np.nan))
        if not behavior.has_gripper and not trusts_camera:
            raise UnmeasurableError(f"no Franka hand is found in any of {len(clip.frames)} frames")
        result = FakeResult(
            track=track,
            anomalies=anomalies,
            frames=framing.crop(clip.frames),
            camera=framing.camera(lens),
            framing=framing,
            choice=replace(choice, **behavior.choice),
            table_height_m=table_height_m,
        )
        return replace(result, **behavior.result)


def make_track(clip, priors, behavior):
    """Return the track of a film, whose poses in the camera frame are those in the base frame, and its anomalies."""
    n = len(clip.t_s)
    s = np.linspace(0.0, 1.0, n)
    p = np.stack([0.4 + 0.1 * s, 0.2 * np.sin(3 * s), 0.3 + 0.05 * np.cos(5 * s)], axis=1)
    X = make_pose(np.broadcast_to(np.diag([1.0, -1.0, -1.0]), (n, 3, 3)), p)
    X = X if priors.X_CH is None else priors.X_CH.copy()
    if not behavior.feasible:
        X[:, 0, 3] += REACH_M
    if priors.depth is not None:
        X[:, 2, 3] = np.median(priors.depth.depth_m, axis=(1, 2))
    if priors.initial_state is not None:
        X[0] = priors.initial_state.X_BG
    anomalies = ()
    if behavior.vanishes:
        first = n // 2
        X[first : first + VANISH] = np.nan
        anomalies = (Anomaly(kind=AnomalyKind.VANISH, frame_start=first, frame_end=first + VANISH - 1, severity=2.0),)
    if not behavior.has_gripper:
        X[:] = np.nan
    posed = np.isfinite(X).all(axis=(1, 2))
    tracked = posed & behavior.is_sure
    confidence = np.where(posed, 0.95 - 0.3 * np.sin(np.pi * s) ** 2, 0.0) * (1.0 if behavior.is_sure else 0.2)
    confidence = confidence if priors.mask is None else priors.mask.mean(axis=(1, 2))
    width = 0.04 + 0.03 * np.cos(4 * s) if priors.finger_width_m is None else priors.finger_width_m
    track = GripperTrack(
        t_s=clip.t_s,
        X_CH=X,
        X_BG=X,
        tracked=tracked,
        confidence=confidence,
        finger_width_m=np.where(posed, width, np.nan),
    )
    return track, anomalies


class FakeResources:
    """Grounding and kinematics of a worker process: a track is feasible as far as the fake arm reaches."""

    def __init__(self, options):
        self._options = options
        self.grounder = FakeGrounder()

    def judge(self, track, table_height_m=None):
        n = len(track.t_s)
        infeasible = bool((track.X_BG[:, 0, 3] > REACH_M).any())
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
        """Judge joint angles, of which the first three are the position of the gripper."""
        posed = np.isfinite(q).all(axis=1)
        X = np.where(posed[:, None, None], make_pose(np.eye(3), np.nan_to_num(q[:, :3])), np.nan)
        track = GripperTrack(
            t_s=t_s,
            X_CH=np.full_like(X, np.nan),
            X_BG=X,
            tracked=posed,
            confidence=posed.astype(float),
            finger_width_m=finger_width_m,
        )
        judgement = self.judge(track)
        return replace(judgement, joints=replace(judgement.joints, q=q), details={"given": "q"})

    def undo_turns(self, trajectory):
        return trajectory

    def misfit(self, trajectory, enough):
        """Return a cost: poses and small angles fit, others do not."""
        return 0.0 if trajectory.q is None else float(np.nanmax(np.abs(trajectory.q)) > 1.6)

    def overlay(self, frames, camera, track, zoom=None, *, gripper=None):
        gate = Fakes.of_environment().behavior(frames).waits_in_overlay
        for number, (frame, X) in enumerate(zip(frames, track.X_BG, strict=True)):
            if number and gate is not None:
                gate.wait()
            image = frame.copy()
            if np.isfinite(X).all():
                u = int(np.clip((X[0, 3] - 0.35) / 0.2, 0, 0.9) * image.shape[1])
                image[image.shape[0] // 2 :, u : u + 6] = [255, 220, 0]
            yield image


def fail_to_load(options):
    """Create the resources of a machine that lacks a library."""
    raise ImportError("libmissing.so: cannot open shared object file")
