"""Tracking with a stride: every K-th frame is measured in full, the hand alone in those between.

A hand that is fitted without its arm, the edges and the depth is off by what changes slowly along a video, so the
corrections of the frames measured in full hold between them, too. Every frame is looked at: where the hand alone looks
worse than beside it, or a second one may be, a frame is measured in full.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, interpolate_pose, invert
from kinebench_drake.grounding.anomaly.appearance import second_gripper
from kinebench_drake.grounding.priors import NO_PRIORS, Priors
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.tracker import CadTracker, HandView, Tracking
from kinebench_drake.io.frames import Frames
from kinebench_drake.track import Domain

# Set on the clips of `python -m benchmarks rate`: clean ones have 0.84 and more, and 1.31 and less.
_LEAST_OVERLAP = 0.8
"""Overlap of mask and rendered gripper from which on a hand alone is taken."""
_MOST_GROWTH = 1.4
"""Greatest residual of its fit over that of the frames beside it."""
_SECOND_SHARE = 0.1
"""Share of a second gripper, half of that of an anomaly, from which on the frames beside are measured in full."""
_COVARIANCE = np.diag([0.004**2] * 3 + [0.001**2] * 3)
"""Covariance that the shortcut adds [rad^2, m^2], on the scale of those of fits, which are too small by 3.5."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StridedTracker:
    """`PoseTracker` that measures every `stride`-th frame in full; all frames of unfamiliar videos."""

    full: CadTracker
    stride: int

    def track(
        self, frames: Frames, camera: Camera, priors: Priors = NO_PRIORS, places: Array | None = None
    ) -> Tracking:
        """Measure the gripper in each of `frames`, as `PoseTracker.track`."""

        def measure(numbers: Iterable[int]) -> Tracking:
            rows = np.array(sorted(numbers))
            return self.full.track(frames[rows], camera, priors.at(rows), None if places is None else places[rows])

        everywhere = range(len(frames))
        keys = sorted({*everywhere[:: self.stride], *everywhere[-1:]})
        if priors.replaces_stage or len(keys) == len(frames):
            return measure(everywhere)
        first = measure(keys)
        if first.domain is not Domain.FAMILIAR:
            return measure(everywhere)
        poses = dict(zip(keys, first.poses, strict=True))
        wide = dict(zip(keys, first.wide, strict=True))
        sure = {
            i: pose
            for i, pose in poses.items()
            if pose is not None
            and pose.arm_agrees
            and second_gripper(wide[i], pose.X_CH, camera, first.gripper) < _SECOND_SHARE
        }
        beside = {i: pair for pair in pairwise(keys) for i in range(pair[0] + 1, pair[1])}
        share = {i: (i - a) / (b - a) for i, (a, b) in beside.items() if a in sure and b in sure}
        near = {i: interpolate_pose(sure[beside[i][0]].X_CH, sure[beside[i][1]].X_CH, own) for i, own in share.items()}
        for i, hand in self.full.fit_hands(frames, camera, near).items():
            before, after = beside[i]
            pose = self._between(hand, sure[before], sure[after], share[i])
            if pose is not None:
                poses[i] = pose
                wide[i] = hand.view
        doubtful = beside.keys() - poses.keys()
        if doubtful:
            rows = doubtful.union(*(beside[i] for i in doubtful))
            again = measure(rows)
            if again.domain is not first.domain:
                return measure(everywhere)
            for i, again_pose, view in zip(sorted(rows), again.poses, again.wide, strict=True):
                poses.setdefault(i, again_pose)
                wide.setdefault(i, view)
        return replace(first, poses=tuple(poses[i] for i in everywhere), wide=tuple(wide[i] for i in everywhere))

    def _between(self, hand: HandView, before: FramePose, after: FramePose, share: float) -> FramePose | None:
        """Return the pose of a hand between two frames measured in full; None if it looks worse than theirs.

        What the hand alone does not show is that of the nearer one.
        """
        first, last = (pose.X_CH @ invert(pose.hand_without_silhouette.X_CH) for pose in (before, after))
        X_CH = interpolate_pose(first, last, share) @ hand.fit.X_CH
        overlap = self.full.overlap(hand, X_CH)
        usual = max(pose.hand_without_silhouette.residual for pose in (before, after))
        if overlap < _LEAST_OVERLAP or hand.fit.residual > _MOST_GROWTH * usual:
            return None
        nearer = before if share < 0.5 else after
        arm = nearer.arm and replace(nearer.arm, X_CH=X_CH, covariance=nearer.arm.covariance + _COVARIANCE)
        return replace(
            nearer,
            X_CH=X_CH,
            finger_m=hand.fit.finger_m,
            finger_sigma_m=hand.fit.finger_sigma_m,
            hand=hand.fit,
            hand_without_silhouette=hand.fit,
            arm=arm,
            view=hand.view,
            overlap=overlap,
            from_prior=False,
            icp=nearer.icp and replace(nearer.icp, X_CH=X_CH, covariance=nearer.icp.covariance + _COVARIANCE),
            is_between=True,
        )
