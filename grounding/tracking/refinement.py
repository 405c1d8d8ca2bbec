"""Refinement of poses along a video: refits from neighbouring frames, and fits to the edges of the images."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.registration.arm_fit import ArmFit, ArmFitter, ArmView
from kinebench_drake.grounding.registration.fit import finger_or_default
from kinebench_drake.grounding.registration.image import GradientImages
from kinebench_drake.grounding.registration.silhouette import SilhouetteMatcher
from kinebench_drake.grounding.registration.solver import BATCH
from kinebench_drake.grounding.tracking.markov import likeliest_postures
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.view import CLOSE_MARGIN, CLOSE_SIZE, Crop, GripperView
from kinebench_drake.io.frames import Frames
from kinebench_drake.segments import evenly
from kinebench_drake.track import Domain

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_GOOD_OVERLAP = 0.8
"""Overlap of the mask from which on a pose whose arm agrees is not doubtful."""
_MIN_COVERAGE = 0.6
"""Least share of a gripper fitted to edges that shows the robot: without it 30 % of absent ones are tracked."""
_LEAST_COVERAGE = 0.4
"""The same where the fit starts from the path of the arm, as the mask of an unfamiliar hand is often incomplete.

Of 43 frames of robosuite and PyBullet from which the hand was taken, four are tracked, all in one clip, where as many
are with the greater share."""
_PATH_RAD = 0.3
"""Largest difference of a joint from the path of the arm for which no other fit is tried [rad]."""
_SMALL_M = 0.0025
"""Median change of a pose by a fit to edges alone up to which they confirm the network's poses, too [m]."""
_FAR_GAIN = 0.18
"""Gain of agreement by a fit to edges alone above which they contradict the network's poses."""
_MISSED_SHARE = 0.1
"""Largest share of frames of a familiar video that are reached by following the arm alone."""
_BEST_SHARE = 0.9
"""Share of the agreement of the best frames from which on a frame is not tried again."""
_AGREEING_SHARE = 0.5
"""Least share of the poses whose arm agrees, of a familiar video."""
_FOLLOWED_FRAMES = 3
"""Frames without a sure pose across which the surface is followed at once."""


def _agreement(pose: FramePose) -> float:
    """Return the share of the contour on edges of the image at a pose that was fitted to them; 0 at others."""
    return float(np.nan_to_num(pose.arm.edge_agreement)) if pose.arm is not None and pose.arm.agrees else 0.0


class EdgeRefinement:
    """Refinement of the poses of a video by the edges of its images.

    Where the edges contradict the network's poses, its look or viewpoint is unfamiliar to the network, whose depth is
    then off by several percent although hand and arm agree: all frames are fitted to the edges alone. In familiar
    videos only doubtful frames are, and all others to edges and network together. Each fit starts from the posture of
    the frame itself, then from those of its neighbours, then from where the arm's surface went since a sure frame.
    """

    def __init__(
        self,
        poses: dict[int, FramePose],
        wide: dict[int, GripperView],
        frames: Frames,
        camera: Camera,
        arm_fitter: ArmFitter,
        silhouette: SilhouetteMatcher,
        measure: Callable[[dict[int, Crop]], dict[int, FramePose]],
        *,
        may_be_familiar: bool,
    ) -> None:
        """Refine `poses` of `frames` (T, H, W, 3), by frame number like the views `wide` that show the arm.

        Args:
            poses: poses by the network.
            wide: views that show the arm.
            frames: frames of the video.
            camera: their camera.
            arm_fitter: fitter of the arm.
            silhouette: comparison of the rendered with the segmented gripper.
            measure: measures frames in these crops, and returns the poses of those that show a gripper.
            may_be_familiar: False if the edges cannot confirm the network, as where the camera was fitted to them.
        """
        self._measure = measure
        self._may_be_familiar = may_be_familiar
        self.poses = dict(poses)
        """Refined poses by frame number."""
        self._wide = wide
        self._images = GradientImages(frames, camera)
        self._fitter = arm_fitter
        self._silhouette = silhouette
        self._sharp: dict[int, tuple[ArmFit, ArmFit]] = {}  # by frame: fit to the cells, and to cells and edges
        self._reached: set[int] = set()  # frames whose pose comes from following the arm
        self._fits: dict[int, list[FramePose]] = {}  # poses that edges confirm, by frame number

    @cached_property
    def is_familiar(self) -> bool:
        """True if the edges agree with the poses of network and edges together, or alone agree hardly better elsewhere.

        A gripper that is too large for its arm agrees with its edges nowhere.
        """
        if not self._may_be_familiar:
            return False
        numbers = [i for i, pose in sorted(self.poses.items()) if pose.arm_agrees and not pose.from_prior]
        estimated = sum(not pose.from_prior for pose in self.poses.values())
        if not numbers or len(numbers) < _AGREEING_SHARE * estimated:
            return bool(self.poses) and estimated == 0
        arms = self._sharpened([numbers[k] for k in evenly(len(numbers), bounds.SAMPLED_FRAMES)])
        agreements = [self._fitter.at([i]).edge_agreement(arm.q, self._images[i]) for i, arm in arms.items()]
        agreement = float(np.median(agreements))
        if agreement >= bounds.CONFIRMATION:
            return True
        fits = [(fit, arms[i]) for i, fit in self._refined(arms).items() if fit is not None]
        if 2 * len(fits) < len(arms):
            return False
        distance = float(np.median([pose_difference(fit.X_CH, arm.X_CH)[0] for fit, arm in fits]))
        gain = float(np.median([fit.edge_agreement for fit, _ in fits])) - agreement
        return distance <= _SMALL_M or (distance <= bounds.FAR_M and gain <= _FAR_GAIN)

    @property
    def domain(self) -> Domain:
        """Domain of the video, after `run`: where the network missed the gripper in many frames, its views mislead."""
        missed = len(self._reached) > _MISSED_SHARE * len(self.poses)
        return Domain.FAMILIAR if self.is_familiar and not missed else Domain.UNFAMILIAR

    def run(self) -> None:
        """Replace the poses: all of an unfamiliar video, else the doubtful ones."""
        doubtful = [i for i, p in self.poses.items() if not (p.arm_agrees and p.overlap >= _GOOD_OVERLAP)]
        self.fit(doubtful if self.is_familiar else list(self.poses))
        self._follow()
        if self.is_familiar:
            self._sharpen()
            return
        for step in (1, -1):
            self._choose_path()
            self._continue_path(step)
        self._choose_path()
        for i, pose in self.poses.items():  # where the edges do not confirm a pose, hand and arm do not agree
            if i not in self.confirmed and pose.arm is not None and not pose.from_prior:
                self.poses[i] = replace(pose, arm=replace(pose.arm, agrees=False))

    def _follow(self) -> None:
        """Follow the arm from sure frames into those beside them that are less sure, forwards and back."""
        for step in (1, -1):
            near: int | None = None
            for i in range(len(self._images))[::step]:
                if near is not None and abs(i - near) <= _FOLLOWED_FRAMES and self._is_less_sure(i, near):
                    self._follow_from(near, i)
                if self._is_sure(i):
                    near = i

    def _follow_from(self, near: int, number: int) -> None:
        """Measure a frame again where the arm of a sure frame went, and keep the pose that the edges confirm more."""
        before = self.poses[near].arm
        fitter = self._fitter.at([number])
        images = (self._images[near], self._images[number])
        arm = None if before is None else fitter.follow(before, self._fitter.at([near]).poses(before), *images)
        if arm is None:
            return
        old = self.poses.get(number)
        pose = self._measure({number: Crop.of_gripper(arm.X_CH, CLOSE_MARGIN, CLOSE_SIZE)}).get(number)
        if pose is None:
            return
        self.poses[number] = pose
        fit = fitter.refine_all(arm.q[None], [self._view(number)], [images[1]], arm.points, may_turn=False)[0]
        self._keep_better(number, fit, _LEAST_COVERAGE)
        if not self._is_sure(number) or (old is not None and _agreement(self.poses[number]) < _agreement(old)):
            del self.poses[number]
            if old is not None:
                self.poses[number] = old
        else:
            self._reached.add(number)

    def _choose_path(self) -> None:
        """Take the poses, of all that edges confirm, that make the likeliest path of the arm."""
        numbers = sorted(self._fits)
        postures = [np.stack([pose.arm.q for pose in self._fits[i] if pose.arm is not None]) for i in numbers]
        agreements = [np.array([_agreement(pose) for pose in self._fits[i]]) for i in numbers]
        if numbers:
            for i, k in zip(numbers, likeliest_postures(numbers, postures, agreements), strict=True):
                self.poses[i] = self._fits[i][k]

    def _continue_path(self, step: int) -> None:
        """Fit frames from where the path of the frames before (step 1) or after (-1) leads, where theirs leaves it."""
        path: list[tuple[int, Array]] = []
        for i in range(len(self._images))[::step]:
            pose = self.poses.get(i)
            if pose is not None and pose.from_prior:
                path = []
                continue
            own = pose.arm.q if pose is not None and pose.arm is not None and _agreement(pose) else None
            predicted = _extrapolate(path, i)
            if predicted is not None and (own is None or np.abs(own - predicted).max() > _PATH_RAD):
                fit = self._fit_from(i, predicted)
                if fit is not None:
                    path.append((i, fit.q))
                    continue
                path = path if own is None else []
            if own is not None:
                path.append((i, own))

    def _fit_from(self, number: int, q: Array) -> ArmFit | None:
        """Return the fit of a frame from a posture (7,) [rad], and note it; None if the edges do not confirm it."""
        fitter = self._fitter.at([number])
        pose = self._measure({number: Crop.of_gripper(fitter.hand(q), CLOSE_MARGIN, CLOSE_SIZE)}).get(number)
        if pose is None:
            return None
        view = ArmView.of(pose.hand, pose.view, self._wide[number])
        [fit] = fitter.refine_all(q[None], [view], [self._images[number]], may_turn=False)
        if fit is None or np.abs(fit.q - q).max() > _PATH_RAD:
            return None
        fitted = self._confirm(number, pose, fit, _LEAST_COVERAGE)
        return None if fitted is None else fit

    def _is_less_sure(self, number: int, near: int) -> bool:
        """Return whether a frame is not sure, or the edges agree less with its arm than with that of a sure frame."""
        pose = self.poses.get(number)
        if pose is None or not self._is_sure(number):
            return pose is None or not pose.from_prior
        return not self.is_familiar and _agreement(pose) < _BEST_SHARE * _agreement(self.poses[near])

    def _is_sure(self, number: int) -> bool:
        """Return whether the arm of a frame agrees with its hand and, in unfamiliar videos, with its edges."""
        pose = self.poses.get(number)
        return pose is not None and pose.arm_agrees and (self.is_familiar or _agreement(pose) > 0.0)

    def _sharpen(self) -> None:
        """Fit poses whose arm agrees to cells and edges together; those fitted to edges alone had doubtful cells."""
        rest = [i for i, pose in self.poses.items() if pose.arm_agrees and not pose.from_prior and not _agreement(pose)]
        for i, arm in self._sharpened(rest).items():
            self.poses[i] = self.poses[i].with_arm(arm, self.poses[i].overlap)

    def _sharpened(self, numbers: Sequence[int]) -> dict[int, ArmFit]:
        """Return the arms of frames fitted to cells and edges together, by frame number."""
        arms = {i: arm for i in numbers if (arm := self.poses[i].arm) is not None}
        old = [i for i, arm in arms.items() if i not in self._sharp or self._sharp[i][0] is not arm]
        for start in range(0, len(old), BATCH):
            batch = old[start : start + BATCH]
            shown = [self._view(i) for i in batch], [self._images[i] for i in batch]
            fits = self._fitter.at(batch).sharpen_all([arms[i] for i in batch], *shown)
            self._sharp.update({i: (arms[i], fit) for i, fit in zip(batch, fits, strict=True)})
        return {i: self._sharp[i][1] for i in arms}

    def fit(self, numbers: Iterable[int]) -> None:
        """Fit frames to the edges, from their own postures, then from those of the frames before and after."""
        ordered = sorted(i for i in numbers if i in self.poses and not self.poses[i].from_prior)
        for i, fit in self._refined({i: arm for i in ordered if (arm := self.poses[i].arm) is not None}).items():
            self._keep_better(i, fit)
        for step in (1, -1):
            agreements = [_agreement(pose) for pose in self.confirmed.values()]
            enough = _BEST_SHARE * float(np.quantile(agreements, bounds.BEST_QUANTILE)) if agreements else 0.0
            for i in ordered[::step]:
                near = self.poses.get(i - step)
                own = _agreement(self.poses[i])
                if near is not None and near.arm is not None and own < min(enough, _agreement(near)):
                    self._keep_better(i, self._refined({i: near.arm})[i])

    @property
    def confirmed(self) -> dict[int, FramePose]:
        """Poses that the edges confirm, by frame number."""
        return {i: pose for i, pose in self.poses.items() if _agreement(pose) > 0.0}

    def _refined(self, starts: Mapping[int, ArmFit]) -> dict[int, ArmFit | None]:
        """Return the fits of frames to their edges, from postures by frame number."""
        numbers = list(starts)
        fits = dict[int, ArmFit | None]()
        for first in range(0, len(numbers), BATCH):
            batch = numbers[first : first + BATCH]
            shown = [self._view(i) for i in batch], [self._images[i] for i in batch]
            of_batch = self._fitter.at(batch).refine_all(np.stack([starts[i].q for i in batch]), *shown)
            fits |= dict(zip(batch, of_batch, strict=True))
        return fits

    def _view(self, number: int) -> ArmView:
        return ArmView.of(self.poses[number].hand, self.poses[number].view, self._wide[number])

    def _keep_better(self, number: int, arm: ArmFit | None, least_coverage: float = _MIN_COVERAGE) -> None:
        """Replace the pose of a frame by a fit that the edges agree with better."""
        pose = self.poses[number]
        fitted = None if arm is None else self._confirm(number, pose, arm, least_coverage)
        if fitted is not None and _agreement(fitted) > _agreement(pose):
            self.poses[number] = fitted

    def _confirm(self, number: int, pose: FramePose, arm: ArmFit, least_coverage: float) -> FramePose | None:
        """Return the pose with a fit that edges and mask confirm, and note it; None if they do not."""
        hand = pose.view, arm.X_CH, finger_or_default(arm.finger_m)
        if not arm.agrees or self._silhouette.coverage(*hand) < least_coverage:
            return None
        fitted = pose.with_arm(arm, self._silhouette.overlap(*hand))
        self._fits.setdefault(number, []).append(fitted)
        return fitted


def _extrapolate(path: Sequence[tuple[int, Array]], number: int) -> Array | None:
    """Return the posture (7,) to which a path of postures leads in a frame [rad]; None if its end is too far away."""
    if not path or abs(number - path[-1][0]) > _FOLLOWED_FRAMES:
        return None
    last, q = path[-1]
    if len(path) == 1 or abs(last - path[-2][0]) > _FOLLOWED_FRAMES:
        return q
    before, q_before = path[-2]
    return np.asarray(q + (q - q_before) * (number - last) / (last - before))
