"""The grounding of one video: frames in, gripper track and anomalies out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera, benchmark_camera
from kinebench_drake.geometry import Array, invert, pose_difference
from kinebench_drake.grounding.anomaly.camera_motion import measure_camera_motion
from kinebench_drake.grounding.anomaly.detect import find_anomalies
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections
from kinebench_drake.grounding.anomaly.evidence import SURE_CONFIDENCE, Evidence, gather
from kinebench_drake.grounding.confidence import GOOD_M, GOOD_RAD, Confidence, frame_features
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.flips import X_HALF_TURN, resolve_flips
from kinebench_drake.grounding.frame_pose import FramePose
from kinebench_drake.grounding.gripper_width import smooth_gripper_width
from kinebench_drake.grounding.smoothing import RawTrack
from kinebench_drake.grounding.tracker import CadTracker, PoseTracker
from kinebench_drake.grounding.view import Frames, GripperView
from kinebench_drake.models.panda.robot import RobotPart, hand_from_tcp
from kinebench_drake.models.perception.weights import load_network
from kinebench_drake.types import NO_PRIORS, Anomaly, GripperTrack, InitialState, InitialStateUse, Priors

TRACKED_CONFIDENCE = 0.3
"""From here on a frame's pose can be relied upon."""
FIRST_M, FIRST_RAD = 0.015, np.deg2rad(6.0)
"""How near to what is seen of it the first frame's pose must lie to be believed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundingResult:
    """What a video shows."""

    track: GripperTrack
    given: NDArray[np.bool_]
    """(T,) frames whose pose was known beforehand."""
    first_frame: InitialStateUse
    """What became of the first frame's pose that was known beforehand."""
    anomalies: tuple[Anomaly, ...]
    camera_motion_px: float | None
    """Largest displacement of the background [px]; None where it has too few features to tell."""
    arm_consistency_px: float | None
    """Median over tracked frames of the distance between the links as seen and as the arm that goes with the hand has
    them [px of the video]; None where too little is seen of the arm."""
    robot: NDArray[np.bool_]
    """(T, H, W) pixels that show the robot."""
    findings: AnomalyDetections | None = None
    """What each detector of anomalies says of each frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What each frame shows, before frames are held against each other."""

    poses: tuple[FramePose | None, ...]
    """(T,) poses against the first frame's camera; None where no gripper was found."""
    evidence: Evidence
    """What the detectors of anomalies look at."""
    wide: tuple[GripperView, ...]
    """(T,) views of whole frames."""


class GroundingPipeline:
    """Tracker, confidence, smoothing, anomalies; one instance serves any number of videos."""

    def __init__(self, tracker: PoseTracker, confidence: Confidence) -> None:
        """Compose the stages."""
        self._tracker, self.confidence = tracker, confidence

    @classmethod
    def create(cls, device: str | None = None) -> "GroundingPipeline":
        """The pipeline with the shipped weights.

        Raises:
            SetupError: weights, calibration, meshes or native libraries are missing.
        """
        return cls(CadTracker(NetworkEstimator(load_network(), device)), Confidence.load())

    def warm_up(self) -> None:
        """Run once on a blank picture: the first use of the network and of the ray caster is slow."""
        camera = benchmark_camera()
        blank = np.zeros((2, camera.height, camera.width, 3), np.uint8)
        self.ground(blank, camera, np.array([0.0, 1.0]))

    def ground(self, frames: Frames, camera: Camera, t_s: Array, known: Priors = NO_PRIORS) -> GroundingResult:
        """Track the gripper through a video.

        Args:
            frames: (T, H, W, 3) RGB.
            camera: what they were taken with, before it is scaled to their size.
            t_s: (T,) task times [s].
            known: what takes the place of estimates.

        Raises:
            InputError: what is known is of another video.
        """
        camera = camera.resized(frames.shape[2], frames.shape[1])
        said = known.initial_state
        if said is not None and self._contradicted(said, frames, camera):
            known = replace(known, initial_state=None)
        if known.initial_state is not None:
            known = known.with_first_pose(_initial_hand_pose(known.initial_state, camera), len(frames))
        observed = self.observe(frames, camera, t_s, known)
        poses, seen = observed.poses, observed.evidence
        findings, motion = find_anomalies(seen), seen.motion
        nothing = np.full((len(frames), 4, 4), np.nan)
        X_given = nothing if known.X_CH is None else motion.X_AC @ known.X_CH
        raw = RawTrack.of(poses, seen.confidence, findings.anomalies, motion.lost, X_given)
        confidence = np.where(raw.given, 1.0, self.confidence.track.probability(raw.features()))
        confidence = np.where(raw.found, confidence, 0.0)
        tracked = confidence >= TRACKED_CONFIDENCE
        X_AH = raw.smoothed(tracked, confidence)
        track = GripperTrack(
            t_s=t_s,
            X_CH=invert(motion.X_AC) @ X_AH,
            X_BG=camera.X_BC @ X_AH @ hand_from_tcp(),
            tracked=tracked,
            confidence=confidence,
            finger_width_m=_widths(poses, tracked, known),
            offset_m=GOOD_M * (not raw.given.all()),
            offset_rad=GOOD_RAD * (not raw.given.all()),
        )
        return GroundingResult(
            track=track,
            given=raw.given,
            first_frame=InitialStateUse.of(said, known.initial_state),
            anomalies=findings.anomalies,
            camera_motion_px=motion.largest_px,
            arm_consistency_px=_arm_consistency_px(poses, tracked),
            robot=np.stack([view.to_frame(view.part > RobotPart.BACKGROUND, camera) for view in observed.wide]),
            findings=findings,
        )

    def _contradicted(self, first: InitialState, frames: Frames, camera: Camera) -> bool:
        """Whether the first frame clearly shows the gripper elsewhere; its reading by itself is no contradiction."""
        pose = self._tracker.track(frames[:1], camera).poses[0]
        if self._confidence_of(pose) < SURE_CONFIDENCE or pose is None:
            return False
        distance, angle = pose_difference(
            _initial_hand_pose(first, camera), np.stack([pose.X_CH, pose.X_CH @ X_HALF_TURN])
        )
        return not bool(((distance <= FIRST_M) & (angle <= FIRST_RAD)).any())

    def _confidence_of(self, pose: FramePose | None) -> float:
        if pose is None:
            return 0.0
        return 1.0 if pose.given else float(self.confidence.frame.probability(frame_features(pose)))

    def observe(self, frames: Frames, camera: Camera, t_s: Array, known: Priors = NO_PRIORS) -> Observation:
        """Look at each frame by itself.

        Where the camera moves a little, the frames are looked at again as the first frame's camera would have seen
        them.
        """
        tracking = self._tracker.track(frames, camera, known)
        motion = measure_camera_motion(frames, tracking.robot, camera)
        steady = motion.moves and not known.replaces_stage
        if steady:
            tracking = self._tracker.track(motion.steadied(frames, camera), camera, known)
        poses = resolve_flips(tracking.poses)
        if not steady:
            poses = [p and replace(p, X_CH=X_AC @ p.X_CH) for p, X_AC in zip(poses, motion.X_AC, strict=True)]
        confidence = np.array([self._confidence_of(p) for p in poses])
        return Observation(
            poses=tuple(poses),
            evidence=gather(frames, camera, t_s, tracking.wide, poses, confidence, motion),
            wide=tracking.wide,
        )


def _initial_hand_pose(state: InitialState, camera: Camera) -> Array:
    """Pose X_CH (4, 4) of panda_hand in the camera frame [m]."""
    return np.asarray(invert(camera.X_BC) @ state.X_BG @ invert(hand_from_tcp()))


def _arm_consistency_px(poses: Sequence[FramePose | None], tracked: NDArray[np.bool_]) -> float | None:
    seen = [p.arm.consistency_px for p, ok in zip(poses, tracked, strict=True) if ok and p and p.arm is not None]
    return float(np.median(seen)) if seen else None


def _widths(poses: Sequence[FramePose | None], tracked: NDArray[np.bool_], known: Priors) -> Array:
    """Gaps (T,) between the pads [m] of the tracked frames; those given count as seen."""
    told = [
        (2 * p.finger_m, 2 * p.finger_sigma_m) if p and ok else (np.nan,) * 2
        for p, ok in zip(poses, tracked, strict=True)
    ]
    width, sigma = np.array(told).T
    if known.finger_width_m is not None:
        given = np.isfinite(known.finger_width_m)
        width, sigma = np.where(given, known.finger_width_m, width), np.where(given, 0.0, sigma)
    return np.where(tracked, smooth_gripper_width(width, sigma), np.nan)
