"""Grounding of one video with one camera: estimation of the gripper track and of anomalies from frames."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import Anomaly, AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.absence import Absence, AbsenceFinder, list_lost
from kinebench_drake.grounding.anomaly.appearance import HandSize
from kinebench_drake.grounding.anomaly.camera_motion import CameraMotion, FeatureTracks, measure_camera_motion
from kinebench_drake.grounding.anomaly.detect import NOT_LOOKED_FOR, AnomalyEvidence, find_anomalies, gather_evidence
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections
from kinebench_drake.grounding.priors import NO_PRIORS, InitialStateUse, Priors
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher
from kinebench_drake.grounding.tracking.camera_path import CameraPath, follow_camera
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.flange_tracker import FlangeTracker
from kinebench_drake.grounding.tracking.markov import resolve_flips, smooth_gripper_width
from kinebench_drake.grounding.tracking.pose import (
    CALIBRATION,
    Confidence,
    FramePose,
    frame_confidence,
    load_confidence,
)
from kinebench_drake.grounding.tracking.smoothing import ON_PATH_CONFIDENCE, RawTrack
from kinebench_drake.grounding.tracking.stride import StridedTracker
from kinebench_drake.grounding.tracking.tracker import CadTracker, PoseTracker, Tracking
from kinebench_drake.grounding.tracking.view import DenseEstimator, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.models.gripper import X_HALF_TURN, GripperModel
from kinebench_drake.models.panda.cad import MAX_FINGER_M, franka_hand
from kinebench_drake.models.panda.description import GripperKind, hand_from_tcp
from kinebench_drake.models.perception.network import WEIGHTS_OF, load_network
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.models.robotiq.cad import robotiq_2f85
from kinebench_drake.segments import evenly
from kinebench_drake.track import Domain, GripperTrack, InitialState

_FIRST_M = 0.015
"""Largest deviation of a stated initial state from a confident estimate of the first frame, to be used [m]."""
_FIRST_RAD = float(np.deg2rad(6.0))
"""The same of its rotation [rad]."""
_FOLLOWED_SHARE = 0.5
"""Least number of frames whose hand and arm agree with a followed camera, over that with a fixed one."""

GRIPPERS: Mapping[GripperKind, Callable[[], GripperModel]] = {
    GripperKind.FRANKA: franka_hand,
    GripperKind.ROBOTIQ_2F85: robotiq_2f85,
}
"""Models of the grippers whose shape is known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineResult:
    """Result of `GroundingPipeline.ground`."""

    track: GripperTrack
    domain: Domain
    gripper: GripperKind = GripperKind.FRANKA
    """Gripper that was looked for."""
    X_MH: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose of the gripper's frame in panda_hand [m]: how it is mounted."""
    from_prior: NDArray[np.bool_]
    """(T,) frames whose pose was taken from priors."""
    first_frame: InitialStateUse
    """Whether the initial state was used."""
    detections: AnomalyDetections
    """Scores and anomalies by kind."""
    camera_path: CameraPath | None = None
    """Camera of each frame, if it moves and was followed."""
    camera_motion_px: float | None
    """Largest displacement of the background [px]; None if it has too few features."""
    arm_consistency_px: float | None
    """Median over tracked frames of the distance between the links as estimated and as posed by the fitted arm [px of
    the video]; None if too little of the arm is visible."""
    wide: tuple[GripperView, ...]
    """(T,) views of whole images."""
    arm_q: Array = field(default_factory=lambda: np.zeros((0, N_JOINTS)))
    """(T, 7) fitted joint angles with the assumed camera [rad]; NaN where hand and arm do not agree; empty without a
    fit."""
    X_CH_raw: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    """(T, 4, 4) poses of panda_hand before confidence and smoothing, in the camera of each frame [m]; NaN where no
    gripper is seen."""
    is_between: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    """(T,) frames of which the hand alone was measured (`StridedTracker`)."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """Curves (T,) of the track file: share of matched points, their distance [m] and weight of ICP; NaN without it."""

    absences: tuple[Absence | None, ...] = ()
    """(T,) why the gripper was not found; None where it was. Empty: it was never asked."""
    hand_size: HandSize | None = None
    """Size of the hand by the arm behind it; None if it is not measured."""

    @property
    def gripper_model(self) -> GripperModel | None:
        """Gripper as it is mounted; None if its shape is unknown."""
        make = GRIPPERS.get(self.gripper)
        return None if make is None else replace(make(), X_MH=self.X_MH)

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(T,) frames in which a gripper is seen, trusted or not."""
        return np.asarray(np.isfinite(self.X_CH_raw).all(axis=(1, 2)))

    @property
    def lost_frames(self) -> list[Json]:
        """Stretches of frames without a pose, each with its reason."""
        return list_lost(self.track.tracked, self.absences or (None,) * len(self.track.tracked))

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """Anomalies in the order of their frames."""
        return self.detections.anomalies

    @property
    def anomalies_open(self) -> tuple[AnomalyKind, ...]:
        """Kinds of anomaly about which the measurements leave it open whether they occur."""
        return self.detections.open_kinds

    @property
    def anomalies_not_looked_for(self) -> tuple[AnomalyKind, ...]:
        """Kinds of anomaly that the look of the video, or a gripper other than Franka's, excludes."""
        return NOT_LOOKED_FOR[self.domain if self.gripper is GripperKind.FRANKA else Domain.ARM]


class GroundingPipeline:
    """Tracker, confidence, smoothing and anomaly detectors; one instance serves any number of videos."""

    def __init__(
        self,
        tracker: PoseTracker,
        confidence: Mapping[Domain, Confidence],
        gripper: GripperKind = GripperKind.FRANKA,
    ) -> None:
        """Compose the pipeline of a tracker that looks for `gripper` and the calibrated `confidence` of its poses."""
        self.tracker = tracker
        self._confidence = confidence
        self._gripper = gripper

    @cached_property
    def _edges(self) -> EdgeMatcher:
        return EdgeMatcher(GRIPPERS.get(self._gripper, franka_hand)())

    @classmethod
    def create(
        cls,
        estimator: DenseEstimator | None = None,
        gripper: GripperKind = GripperKind.FRANKA,
        *,
        weights: Path | None = None,
        calibration: Path | None = None,
    ) -> Self:
        """Create the pipeline; without a gripper of known shape it measures the arm alone.

        Without an estimator the network is taken; `weights` and `calibration` replace those shipped.

        Raises:
            SetupError: weights, calibration, meshes or native libraries are missing.
        """
        estimator = estimator or NetworkEstimator(load_network(weights or WEIGHTS_OF[gripper]))
        confidence = load_confidence(calibration or CALIBRATION)
        tracker: PoseTracker = FlangeTracker(estimator)
        if gripper is not GripperKind.NONE:
            tracker = CadTracker(estimator, GRIPPERS[gripper](), confidence)
        return cls(tracker, confidence, gripper)

    def ground(
        self, frames: Frames, camera: Camera, t_s: Array, priors: Priors = NO_PRIORS, stride: int = 1
    ) -> PipelineResult:
        """Estimate the gripper track of a video.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: camera of the frames, at any size of the same shape.
            t_s: (T,) task times [s].
            priors: quantities that replace their estimates.
            stride: every how many frames are measured in full, where the hand is Franka's.

        Raises:
            InputError: the priors do not fit the video.
        """
        camera = camera.resized(frames.shape[2], frames.shape[1])
        initial_state = priors.initial_state
        if initial_state is not None and self._contradicts(initial_state, frames, camera):
            priors = replace(priors, initial_state=None)
        if priors.initial_state is not None:
            priors = priors.with_first_pose(_initial_hand_pose(priors.initial_state, camera), len(frames))
        if self._gripper is GripperKind.ROBOTIQ_2F85:  # poses in its frame need its mount, which is found only now
            priors = replace(priors, X_CH=None, initial_state=None)
        tracking, evidence = self.observe(frames, camera, t_s, priors, stride)
        poses = tracking.poses
        is_between = np.array([pose is not None and pose.is_between for pose in poses])
        motion = evidence.motion
        detections = find_anomalies(evidence)
        no_poses = np.full((len(frames), 4, 4), np.nan)
        X_prior = no_poses if priors.X_CH is None else motion.X_AC @ priors.X_CH
        if priors.initial_state is not None and priors.X_CH is not None:
            X_prior[0] = priors.X_CH[0]
        raw = RawTrack.from_poses(poses, evidence.confidence, detections.anomalies, motion.lost, X_prior, t_s)
        probability = self._confidence[evidence.domain].track.probability(raw.features())
        confidence = np.where(raw.has_pose, np.where(raw.from_prior, 1.0, probability), 0.0)
        confidence[raw.on_path(confidence >= bounds.TRACKED_CONFIDENCE)] = ON_PATH_CONFIDENCE
        tracked = confidence >= bounds.TRACKED_CONFIDENCE
        X_HM = invert(tracking.gripper.X_MH)
        X_AM = raw.smooth(tracked, confidence) @ X_HM
        track = GripperTrack(
            t_s=t_s,
            X_CH=invert(motion.X_AC) @ X_AM,
            X_BG=camera.X_BC @ X_AM @ hand_from_tcp(),
            tracked=tracked,
            confidence=confidence,
            finger_width_m=_gripper_width(poses, tracked, priors, tracking.gripper),
            offset_m=bounds.GOOD_M * (not raw.from_prior.all()),
            offset_rad=bounds.GOOD_RAD * (not raw.from_prior.all()),
            turn_is_sure=not tracking.gripper.is_symmetric,
        )
        return PipelineResult(
            track=track,
            gripper=self._gripper,
            domain=evidence.domain,
            from_prior=raw.from_prior,
            first_frame=InitialStateUse.of(initial_state, priors.initial_state),
            detections=detections,
            absences=evidence.absences,
            hand_size=evidence.size,
            camera_path=motion.path,
            camera_motion_px=None if motion.is_unknown else motion.largest_px,
            arm_consistency_px=_arm_consistency_px(poses, tracked),
            wide=tracking.wide,
            arm_q=np.stack([p.own_q if p else np.full(N_JOINTS, np.nan) for p in poses]),
            X_CH_raw=invert(motion.X_AC) @ np.stack([no_poses[0] if p is None else p.X_CH for p in poses]) @ X_HM,
            X_MH=tracking.gripper.X_MH,
            is_between=is_between,
            curves={
                **_icp_curves(poses),
                "repeated": evidence.still.astype(np.float64),
                **({"between": is_between.astype(np.float64)} if is_between.any() else {}),
                **{f"fault_{kind.value}": each.score for kind, each in detections.by_kind.items()},
            },
        )

    def _contradicts(self, state: InitialState, frames: Frames, camera: Camera) -> bool:
        """Return whether the first frame confidently shows the gripper elsewhere; a 180-degree flip is tolerated."""
        tracking = self.tracker.track(frames[:1], camera)
        pose = tracking.poses[0]
        if pose is None or frame_confidence(pose, tracking.domain, self._confidence) < bounds.TRACKED_CONFIDENCE:
            return False
        distance, angle = pose_difference(
            _initial_hand_pose(state, camera), np.stack([pose.X_CH, pose.X_CH @ X_HALF_TURN])
        )
        return not bool(((distance <= _FIRST_M) & (angle <= _FIRST_RAD)).any())

    def observe(
        self, frames: Frames, camera: Camera, t_s: Array, priors: Priors = NO_PRIORS, stride: int = 1
    ) -> tuple[Tracking, AnomalyEvidence]:
        """Measure each frame, and gather the evidence for anomalies, without confidence and smoothing along the video.

        If the camera moves, it is followed, and frames warped into the orientation of the first camera are measured.
        Arguments are those of `ground`, with the camera at the size of the frames.
        """
        stabilized = not priors.replaces_stage
        tracker = self.tracker
        if stride > 1 and isinstance(tracker, CadTracker) and self._gripper is GripperKind.FRANKA:
            tracker = StridedTracker(full=tracker, stride=stride)
        tracks = FeatureTracks(frames)
        motions = dict[bytes, CameraMotion]()

        def measure_motion(robot: NDArray[np.bool_]) -> CameraMotion:
            """Measure the motion of the camera, once for each mask of the robot."""
            key = robot.tobytes()
            if key not in motions:
                motions[key] = self._measure_motion(frames, tracks, robot, camera, priors)
            return motions[key]

        motion = self._follow(frames, tracks, camera, priors, measure_motion) if stabilized else None
        steady = frames, camera
        if motion is not None:
            steady = motion.stabilize(frames, camera)
            tracking = tracker.track(*steady, priors, motion.places)
        else:
            tracking = tracker.track(frames, camera, priors)
            motion = measure_motion(tracking.robot)
            if stabilized and (motion.moves or motion.path is not None):
                steady = motion.stabilize(frames, camera)
                tracking = tracker.track(*steady, priors, motion.places)
        resolved: Sequence[FramePose | None] = tracking.poses
        if tracking.domain is not Domain.ARM:
            resolved = resolve_flips(tracking.poses, is_symmetric=tracking.gripper.is_symmetric)
        X_AC = motion.X_AS if stabilized else motion.X_AC
        poses = [p and replace(p, X_CH=X @ p.X_CH) for p, X in zip(resolved, X_AC, strict=True)]
        confidence = np.array([frame_confidence(p, tracking.domain, self._confidence) for p in poses])
        places = motion.places if stabilized else None

        def explain(present: NDArray[np.bool_]) -> tuple[Absence | None, ...]:
            finder = AbsenceFinder(_arm_model(tracking.gripper), self._edges)
            return finder.explain(*steady, places, tracking.wide, resolved, present)

        evidence = gather_evidence(
            frames, camera, t_s, tracking.wide, poses, confidence, motion, tracking.domain, tracking.gripper, explain
        )
        return replace(tracking, poses=tuple(poses)), evidence

    def _follow(
        self,
        frames: Frames,
        tracks: FeatureTracks,
        camera: Camera,
        priors: Priors,
        measure_motion: Callable[[NDArray[np.bool_]], CameraMotion],
    ) -> CameraMotion | None:
        """Return the motion of a camera that clearly moves and can be followed; None otherwise.

        In some frames hand and arm must agree nearly as often as without following it: else the background moves.
        """
        nothing = np.zeros(frames.shape[1:3], dtype=bool)
        if not self._measure_motion(frames, tracks, nothing, camera, priors, follows=False).is_clear:
            return None
        robot = self.tracker.track(frames[:1], camera).robot
        motion = measure_motion(robot)
        if motion.path is None:
            return None
        steady, wide = motion.stabilize(frames, camera)
        chosen = evenly(len(frames), bounds.SAMPLED_FRAMES)
        places = None if motion.places is None else motion.places[chosen]
        fixed = self.tracker.track(frames[chosen], camera).agreeing
        if fixed == 0:
            return motion
        followed = self.tracker.track(steady[chosen], wide, places=places).agreeing
        return motion if followed >= _FOLLOWED_SHARE * fixed else replace(motion, path=None)

    def _measure_motion(
        self,
        frames: Frames,
        tracks: FeatureTracks,
        robot: NDArray[np.bool_],
        camera: Camera,
        priors: Priors,
        *,
        follows: bool = True,
    ) -> CameraMotion:
        """Measure the motion of the camera, and follow it if it moves and `follows`."""
        motion = measure_camera_motion(tracks, robot, camera)
        reference = self._reference(frames, robot, camera, priors)
        if not motion.moves and not motion.is_unknown and reference is None:
            return motion
        if not follows:
            return motion if reference is None else replace(motion, px=np.full(len(frames), np.inf))
        start = frames[0] if reference is None else reference
        return motion.with_path(follow_camera(frames, start, robot, camera, priors.table_height_m or 0.0))

    @staticmethod
    def _reference(
        frames: Frames, robot: NDArray[np.bool_], camera: Camera, priors: Priors
    ) -> NDArray[np.uint8] | None:
        """Return the image of the camera, if it is known and the first frame does not show the same view."""
        if priors.image is None or priors.image.shape != frames.shape[1:]:
            return None
        motion = measure_camera_motion(FeatureTracks(np.stack([priors.image, frames[0]])), robot, camera)
        return priors.image if motion.moves or np.isnan(motion.px[1]) else None


_arm_model = lru_cache(maxsize=4)(ArmModel)


def _initial_hand_pose(state: InitialState, camera: Camera) -> Array:
    """Return the pose X_CH (4, 4) of panda_hand in the camera frame [m]."""
    return np.asarray(invert(camera.X_BC) @ state.X_BG @ invert(hand_from_tcp()))


def _arm_consistency_px(poses: Sequence[FramePose | None], tracked: NDArray[np.bool_]) -> float | None:
    distances = [p.arm.consistency_px for p, ok in zip(poses, tracked, strict=True) if ok and p and p.arm is not None]
    return float(np.median(distances)) if distances else None


def _icp_curves(poses: Sequence[FramePose | None]) -> dict[str, Array]:
    fused = [None if p is None else p.icp for p in poses]
    rows = [(np.nan,) * 3 if f is None else (f.registration.fitness, f.registration.rmse_m, f.weight) for f in fused]
    return dict(zip(("icp_fitness", "icp_rmse_m", "icp_weight"), np.array(rows).T, strict=True))


def _gripper_width(
    poses: Sequence[FramePose | None], tracked: NDArray[np.bool_], priors: Priors, gripper: GripperModel
) -> Array:
    """Return the smoothed gripper width (T,) of the tracked frames [m]; widths from priors are exact.

    Widths are smoothed as shares of the greatest one.
    """
    unit = gripper.max_finger_m / MAX_FINGER_M
    measured = [
        (2 * p.finger_m, 2 * p.finger_sigma_m) if p and ok else (np.nan,) * 2
        for p, ok in zip(poses, tracked, strict=True)
    ]
    width, sigma = np.array(measured).T
    by_edges = [p.gap_log_likelihood if p and ok else None for p, ok in zip(poses, tracked, strict=True)]
    if priors.finger_width_m is not None:
        from_prior = np.isfinite(priors.finger_width_m)
        width = np.where(from_prior, priors.finger_width_m, width)
        sigma = np.where(from_prior, 0.0, sigma)
    return np.where(tracked, unit * smooth_gripper_width(width / unit, sigma / unit, by_edges), np.nan)
