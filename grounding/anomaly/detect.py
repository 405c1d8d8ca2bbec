"""All anomaly detectors applied to the measurements of a video."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, invert, transform_points
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.anomaly.absence import Absence
from kinebench_drake.grounding.anomaly.appearance import (
    HandSize,
    find_deformations,
    find_duplicates,
    find_misshapen,
    find_vanishing,
    measure_size,
    second_gripper,
    shape_misfit,
)
from kinebench_drake.grounding.anomaly.camera_motion import CameraMotion, find_camera_motion
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections, Detection
from kinebench_drake.grounding.anomaly.jumps import (
    find_finger_faults,
    find_freezes,
    find_teleports,
    is_mixed,
    still_frames,
)
from kinebench_drake.grounding.registration.hand_contour import HandShape
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.gripper import GripperModel
from kinebench_drake.segments import finite_rows
from kinebench_drake.track import Domain

# Set on planted faults in home renders of seen assets, and checked on clean ones:
# `python -m benchmarks planted-videos --out faulty`, then `python -m benchmarks evaluate faulty`.
_SCORE_SPREAD = 0.06
"""Relative distance of a detector's score from its bound, 1, within which it decides nothing in familiar videos.

Scores near the bound differ by up to a factor of 1.12 there between float32 and bfloat16, and of 1.5 in other videos
(`python -m benchmarks precision`)."""
_SCORE_SPREAD_ELSEWHERE = 0.25
"""The same in unfamiliar videos."""
_ABSENT_AGREEMENT = 0.2
"""Share of the hand's contours on image edges below which they lie there by chance, as where there is no hand."""
_FAIR_CONFIDENCE = 0.1
"""Least confidence at which a frame's position and misfit count."""
_GOOD_CONFIDENCE = 0.5
"""Least confidence at which a frame's size, contour and jumps count.

A deformed gripper has a low one, and an error of a few degrees falsifies the size."""
_MAX_SIDE_COSINE = 0.4
"""Largest cosine between the fingers' axis and the line of sight at which the size counts.

From here on the size of clean hands is biased (11 videos of suite 2, unseen)."""
_MAX_CONTOUR_COSINE = 0.85
"""Largest such cosine at which the contour counts: edge-on a gripper is narrow, and its fingers hide each other."""
_WIDTH_SIGMA_M = 0.006
"""Largest standard deviation of a width that counts for an anomaly [m]."""
NOT_LOOKED_FOR: Mapping[Domain, tuple[AnomalyKind, ...]] = MappingProxyType(
    {
        Domain.FAMILIAR: (),
        Domain.UNFAMILIAR: (AnomalyKind.DUPLICATE, AnomalyKind.FINGERS),
        Domain.ARM: (AnomalyKind.DUPLICATE, AnomalyKind.DEFORMATION, AnomalyKind.FINGERS),
    }
)
"""Kinds of anomaly whose measurements mean nothing in a domain."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AnomalyEvidence:
    """Input of the detectors: series over the T frames of a video; NaN where unknown.

    In an unfamiliar video the network's measurements of the gripper's shape, and of things like grippers, mean nothing:
    the shape is that of the hand's contour on image edges.
    """

    t_s: Array
    """(T,) task time [s]."""
    p_C: Array
    """(T, 3) centre of the gripper in the camera frame [m]."""
    covariance: Array
    """(T, 3, 3) its covariance [m^2]."""
    confidence: Array
    """(T,) confidence 0..1, 0 without a detection."""
    absences: tuple[Absence | None, ...]
    """(T,) why the gripper was not found; None where it was."""
    explained: Array
    """(T,) cells of the crop explained by the posed gripper, or as many as the edges confirm; 0 without a detection,
    infinite where edges confirm the hand."""
    finger_width_m: Array
    """(T,) gripper width [m] where it is measured precisely."""
    other: Array
    """(T,) share of a second gripper."""
    misfit: Array
    """(T,) relative misfit of the gripper's shape."""
    residual: Array
    """(T,) residual of the cells against the rigid gripper [standard deviations]."""
    scale: Array
    """(T,) apparent size of the hand over its size at the distance given by the arm, unless seen edge-on."""
    shapes: tuple[HandShape | None, ...]
    """(T,) shape of the hand's contour; None where unknown, and in familiar videos."""
    still: NDArray[np.bool_]
    """(T,) frames that repeat the one before."""
    mixed: Callable[[int], bool]
    """Returns whether a frame, by its number, mixes those before and after; none does if the camera moves."""
    motion: CameraMotion
    domain: Domain = Domain.FAMILIAR

    def __post_init__(self) -> None:
        """Check that all series have the same length.

        Raises:
            InputError: a length differs.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray | tuple) and len(value) != len(self.t_s):
                raise InputError(f"{field.name} is of {len(value)} frames, t_s of {len(self.t_s)}; they must be equal")

    @property
    def expected(self) -> NDArray[np.bool_]:
        """(T,) frames in which the gripper is seen, or should be."""
        return np.array([absence in (None, Absence.GONE) for absence in self.absences])

    @property
    def size(self) -> HandSize | None:
        """Size of the hand; None if too few frames show it."""
        return measure_size(self.scale)

    @property
    def fair(self) -> NDArray[np.bool_]:
        """(T,) frames whose position counts."""
        return np.asarray(self.confidence >= _FAIR_CONFIDENCE)

    @property
    def good(self) -> NDArray[np.bool_]:
        """(T,) frames whose pose is more likely right than wrong."""
        return np.asarray(self.confidence >= _GOOD_CONFIDENCE)


def gather_evidence(
    frames: Frames,
    camera: Camera,
    t_s: Array,
    wide: Sequence[GripperView],
    poses: Sequence[FramePose | None],
    confidence: Array,
    motion: CameraMotion,
    domain: Domain,
    gripper: GripperModel,
    explain: Callable[[NDArray[np.bool_]], tuple[Absence | None, ...]],
) -> AnomalyEvidence:
    """Compute the input of the detectors for the frames (T, H, W, 3) of a video.

    Poses (T,) of the `gripper`, with flips resolved, are in the `camera` of the first frame; their confidence (T,) is 0
    where there is none, and `wide` (T,) are views of whole images. `explain` tells why it is not found in frames
    without it, from those (T,) with it.
    """
    n = len(frames)
    familiar = domain is Domain.FAMILIAR and gripper.linkage is None
    p_C = np.full((n, 3), np.nan)
    covariance = np.full((n, 3, 3), np.nan)
    explained = np.zeros(n)
    width, misfit, residual, scale = (np.full(n, np.nan) for _ in range(4))
    for i, pose in ((i, pose) for i, pose in enumerate(poses) if pose is not None):
        explained[i] = pose.hand.points * pose.overlap
        if pose.arm is not None and pose.arm.agrees:
            agreement = float(np.nan_to_num(pose.arm.hand_agreement))
            if agreement >= bounds.EDGE_AGREEMENT:
                explained[i] = np.inf
            elif domain is Domain.UNFAMILIAR:
                explained[i] = max(explained[i], bounds.ABSENT_CELLS * agreement / _ABSENT_AGREEMENT)
        p_C[i] = transform_points(pose.X_CH, GRIPPER_CENTRE_H[None])[0]
        lever = np.cross(np.eye(3), p_C[i] - pose.X_CH[:3, 3])
        by_pose = np.vstack([lever, np.eye(3)])
        covariance[i] = by_pose.T @ pose.covariance @ by_pose
        if familiar and confidence[i] >= _FAIR_CONFIDENCE:
            hand = pose.hand_without_silhouette
            sharp = 2 * hand.finger_sigma_m <= bounds.SHARP_M
            misfit[i] = shape_misfit(pose.view, hand.X_CH, hand.finger_m if sharp else np.nan)
            residual[i] = hand.residual
        if familiar and confidence[i] >= bounds.TRACKED_CONFIDENCE:
            width[i] = 2 * pose.finger_m if 2 * pose.hand.finger_sigma_m <= _WIDTH_SIGMA_M else np.nan
            if _side_cosine(pose) <= _MAX_SIDE_COSINE and pose.arm is not None and confidence[i] >= _GOOD_CONFIDENCE:
                scale[i] = pose.arm.scale
    X_SA = invert(motion.X_AS)
    other = [
        second_gripper(view, None if pose is None else X @ pose.X_CH, camera, gripper) if familiar else np.nan
        for view, pose, X in zip(wide, poses, X_SA, strict=True)
    ]
    present = (confidence >= _FAIR_CONFIDENCE) & (explained >= bounds.ABSENT_CELLS)
    shapes = [
        pose.shape if pose is not None and c >= _GOOD_CONFIDENCE and _side_cosine(pose) <= _MAX_CONTOUR_COSINE else None
        for pose, c in zip(poses, confidence, strict=True)
    ]
    return AnomalyEvidence(
        t_s=t_s,
        p_C=p_C,
        covariance=covariance,
        confidence=confidence,
        absences=explain(present & finite_rows(p_C)),
        explained=explained,
        finger_width_m=width,
        other=np.array(other),
        misfit=misfit,
        residual=residual,
        scale=scale,
        shapes=tuple(shapes),
        still=still_frames(frames),
        mixed=lambda number: not motion.moves and is_mixed(frames, number),
        motion=motion,
        domain=domain,
    )


def _side_cosine(pose: FramePose) -> float:
    """Return the cosine between the fingers' axis and the line of sight."""
    p_C = transform_points(pose.X_CH, GRIPPER_CENTRE_H[None])[0]
    return abs(float(pose.X_CH[:3, 1] @ p_C)) / float(np.linalg.norm(p_C))


def find_anomalies(evidence: AnomalyEvidence) -> AnomalyDetections:
    """Apply every detector; the jump that ends a freeze is part of the freeze, no teleport.

    Where the gripper has vanished, poses are false, and none jumps.

    An anomaly whose score is nearer to its bound than the spread between number formats is none: its kind is open.
    """
    e = evidence
    familiar = e.domain is Domain.FAMILIAR
    # in an unfamiliar video a doubtful pose is one, too
    confidence = e.confidence if familiar else (e.confidence > 0.0).astype(np.float64)
    vanishing = find_vanishing(confidence, e.explained, e.expected)
    present = e.good & (vanishing.score <= 1.0)
    freezes = find_freezes(e.p_C, e.fair, e.still, e.t_s)
    detections = (
        vanishing,
        find_duplicates(e.other),
        _without(
            find_teleports(e.p_C, e.covariance, present, e.mixed, e.t_s), {a.frame_end + 1 for a in freezes.anomalies}
        ),
        freezes,
        find_deformations(e.misfit, e.residual) if familiar else find_misshapen(e.shapes),
        find_camera_motion(e.motion),
        find_finger_faults(e.finger_width_m),
    )
    spread = _SCORE_SPREAD if familiar else _SCORE_SPREAD_ELSEWHERE
    return AnomalyDetections(by_kind={each.kind: each.beyond(spread) for each in detections}, spread=spread)


def _without(detection: Detection, frames: set[int]) -> Detection:
    """Return a detection without the anomalies that begin within one frame of `frames`."""
    score = detection.score.copy()
    near = {f + d for f in frames for d in (-1, 0, 1)}
    score[[f for f in near if 0 <= f < len(score)]] = 0.0
    return replace(
        detection,
        score=np.asarray(score),
        anomalies=tuple(a for a in detection.anomalies if a.frame_start not in near),
    )
