"""Tracking of the flange by the arm alone, whatever gripper it carries.

The network proposes a posture in each frame; the contours of the last links on edges of the image decide. Looks differ
from those that the network was trained on, so the arm is followed from the frames where its contours lie best into
their neighbours, which needs no network. Its turn about the flange comes from all frames together, as the optical flow
of its surface shows how it turns between them.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.priors import NO_PRIORS, Priors
from kinebench_drake.grounding.registration.arm_fit import LAST_LINKS, ArmFitter
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import EdgeMatcher, unknown_gripper
from kinebench_drake.grounding.registration.fit import MIN_CELLS
from kinebench_drake.grounding.registration.image import GradientImages
from kinebench_drake.grounding.registration.solver import Correspondences
from kinebench_drake.grounding.tracking.flange_fit import REACHES_PX, ChainFitter, FlangeFitter, FlangeView
from kinebench_drake.grounding.tracking.localization import find_region
from kinebench_drake.grounding.tracking.markov import OFFSETS_RAD, TURNS_RAD, likeliest_turns
from kinebench_drake.grounding.tracking.pose import FramePose
from kinebench_drake.grounding.tracking.tracker import Tracking
from kinebench_drake.grounding.tracking.view import (
    CLOSE_SIZE,
    Crop,
    DenseEstimator,
    GripperView,
)
from kinebench_drake.io.frames import Frames
from kinebench_drake.models.panda.description import RobotPart
from kinebench_drake.track import Domain

# Chosen by hand on own renders; checked by `python -m benchmarks evaluate` on these, by `footage` on others' videos.
_NEIGHBOUR_LEAD = 0.05
"""Least lead of a neighbour's agreement that makes its posture of the flange the better one."""
_LOST_SHARE = 0.8
"""Share of the agreement of a frame below which the flange was not followed from it."""
_ON_BASE_M = 0.06
"""Largest displacement of a flange by the base of its arm [m]."""
_BASE_LOSS = 0.1
"""Largest loss of agreement by the base of the arm."""

_SEEN = (*LAST_LINKS, RobotPart.HAND)
"""Parts whose cells lie where the wrist is: those of a gripper are taken for a hand."""
_QUANTILES = (5.0, 95.0)
"""Percentiles of the wrist's cells between which it extends."""
_MARGIN = 0.8
"""Half the size of the wrist's crop over this extent."""
_TURN_SIGMA_RAD = np.deg2rad(6.0)
"""Standard deviation of the likeliest turns, before each frame is fitted once more [rad]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _FlangeVideo:
    """Input of one call."""

    frames: Frames
    camera: Camera
    wide: Mapping[int, GripperView]
    """Views that show the whole arm, by frame number."""
    images: GradientImages
    arm: ArmFitter
    flange: FlangeFitter


class FlangeTracker:
    """`PoseTracker` by the last links; the pose of panda_hand follows from the flange."""

    def __init__(self, estimator: DenseEstimator) -> None:
        """Track with dense estimates of `estimator`."""
        self._estimator = estimator
        self._model = ArmModel()
        self._edges = EdgeMatcher(unknown_gripper())
        self._chain = ChainFitter(self._model)

    def track(
        self, frames: Frames, camera: Camera, priors: Priors = NO_PRIORS, places: Array | None = None
    ) -> Tracking:
        """Measure the flange in each of `frames` (T, H, W, 3); of `priors` none is used."""
        whole = dict.fromkeys(range(len(frames)), Crop.of_frame(camera))
        wide = dict(self._estimator.estimate(frames, camera, whole))
        region = find_region(self._estimator, frames, camera, wide)
        if region is not None:
            wide = dict(self._estimator.estimate(frames, camera, dict.fromkeys(whole, region)))
        video = _FlangeVideo(
            frames=frames,
            camera=camera,
            wide=wide,
            images=GradientImages(frames, camera),
            arm=ArmFitter(camera, self._model, self._edges, places),
            flange=FlangeFitter(self._chain, self._edges),
        )
        poses = self._detect(video)
        self._spread(poses, video)
        self._turn(poses, video)
        return Tracking(
            poses=tuple(poses.get(i) for i in range(len(frames))),
            wide=tuple(wide[i] for i in range(len(frames))),
            robot=wide[0].to_frame(wide[0].part > 0, camera),
            domain=Domain.ARM,
        )

    def _look(self, crops: Mapping[int, Crop], video: _FlangeVideo) -> Iterator[tuple[int, FlangeView]]:
        """Yield what some frames show of the last links, by frame number."""
        for i, view in self._estimator.estimate(video.frames, video.camera, crops):
            yield i, FlangeView(view=view, cells=_link_cells(view, video.wide[i]), image=video.images[i])

    def _detect(self, video: _FlangeVideo) -> dict[int, FramePose]:
        """Return the poses of the frames that show the last links, each by itself."""
        crops = {i: crop for i, view in video.wide.items() if (crop := _wrist_crop(view)) is not None}
        for i, shown in self._look(dict(crops), video):
            chain = self._chain.fit(shown.cells)
            if chain is not None:
                crops[i] = Crop.of_wrist(chain.model.X_CH[0], CLOSE_SIZE)
        detected = {i: video.flange.detect(shown) for i, shown in self._look(crops, video)}
        return {i: pose for i, pose in detected.items() if pose is not None}

    def _spread(self, poses: dict[int, FramePose], video: _FlangeVideo) -> None:
        """Take the arm from the surest frames to their neighbours, where its contours then lie better on edges."""
        waiting = set(video.wide)
        while rest := waiting & poses.keys():
            i = max(rest, key=lambda k: poses[k].overlap)
            waiting.remove(i)
            for k in {i - 1, i + 1} & waiting:
                proposed = [poses.get(k), video.flange.follow(poses[i], video.images[i], video.images[k])]
                if _agreement(proposed[1]) < _LOST_SHARE * _agreement(poses[i]):
                    ((_, shown),) = self._look({k: Crop.of_wrist(poses[i].X_CH, CLOSE_SIZE)}, video)
                    proposed.append(video.flange.detect(shown, poses[i]))
                best = max(proposed, key=_agreement)
                if best is not None and _agreement(best) > _agreement(proposed[0]) + _NEIGHBOUR_LEAD:
                    poses[k] = best

    def _turn(self, poses: dict[int, FramePose], video: _FlangeVideo) -> None:
        """Turn the last joint as contours and cells of the last link are likeliest along the whole video."""
        flange = video.flange
        images = video.images
        shown = dict(self._look({i: Crop.of_wrist(pose.X_CH, CLOSE_SIZE) for i, pose in poses.items()}, video))
        chains = {i: flange.chain_of(pose) for i, pose in poses.items()}
        turns = np.zeros(len(images))
        sigma = np.zeros(len(images))
        for grid in (TURNS_RAD, OFFSETS_RAD):
            log_likelihood = np.zeros((len(turns), len(grid)))
            changes = np.full(len(turns) - 1, np.nan)
            for i, chain in chains.items():
                view = shown[i].view
                log_likelihood[i] = flange.log_likelihood(chain, turns[i] + grid, view, images[i], poses[i].overlap)
                if i + 1 in chains:
                    changes[i] = flange.turn_change(chain, chains[i + 1], images[i], images[i + 1])
            offsets, own_sigma = likeliest_turns(grid, log_likelihood, changes - np.diff(turns))
            turns = turns + offsets
            sigma = np.maximum(sigma, own_sigma)
            chains = {i: self._chain.turned(chain, turns[i : i + 1]) for i, chain in chains.items()}
        reaches_px = REACHES_PX[-2:]
        before = dict(poses)
        for i, chain in chains.items():
            flows = {k: flange.flow(chains[k], images[k], images[i]) for k in {i - 1, i + 1} & chains.keys()}
            points = [
                replace(flow, weight=_certainty(before[k], before[i]) * flow.weight)
                for k, flow in flows.items()
                if flow is not None
            ]
            pose = flange.fit_turned(chain, turns[i], _TURN_SIGMA_RAD, shown[i], reaches_px, points)
            if pose is not None:
                poses[i] = _with_turn_sigma(self._on_base(pose, i, video) or pose, sigma[i])

    def _on_base(self, pose: FramePose, number: int, video: _FlangeVideo) -> FramePose | None:
        """Return a pose that the base of the camera confirms, with the arm on it; None if it does not."""
        links = _link_cells(pose.view, video.wide[number])
        arm = video.arm.at([number]).fit_links(pose.X_CH, _TURN_SIGMA_RAD, links, video.images[number])
        if arm is None or arm.edge_agreement < max(bounds.EDGE_AGREEMENT, pose.overlap - _BASE_LOSS):
            return None
        distance, angle = pose_difference(arm.X_CH, pose.X_CH)
        is_near = distance <= _ON_BASE_M and angle <= bounds.MAX_ANGLE_RAD
        return replace(pose, X_CH=arm.X_CH, arm=arm, overlap=arm.edge_agreement) if is_near else None


def _agreement(pose: FramePose | None) -> float:
    return 0.0 if pose is None else pose.overlap


def _certainty(pose: FramePose, other: FramePose) -> float:
    """Return the information of a pose as a share of that of two, by the variance of their positions."""
    variance, other_variance = (float(np.trace(p.covariance[3:, 3:])) for p in (pose, other))
    return other_variance / (variance + other_variance)


def _with_turn_sigma(pose: FramePose, sigma_rad: float) -> FramePose:
    """Return a pose whose covariance includes a standard deviation of its turn about the flange's axis."""
    if pose.arm is None:
        return pose
    covariance = pose.arm.covariance.copy()
    axis = pose.X_CH[:3, 2]
    covariance[:3, :3] += sigma_rad**2 * np.outer(axis, axis)
    hand = replace(pose.hand, covariance=covariance)
    return replace(pose, arm=replace(pose.arm, covariance=covariance), hand=hand, hand_without_silhouette=hand)


def _link_cells(close: GripperView, wide: GripperView) -> Correspondences:
    return Correspondences.join([Correspondences.of_view(v, v.arm) for v in (close, wide)])


def _wrist_crop(view: GripperView) -> Crop | None:
    """Return the crop around the last links in a view of the whole image; None if it shows too few of their cells."""
    cells = np.isin(view.part, _SEEN)
    if cells.sum() < MIN_CELLS:
        return None
    low, high = np.percentile(np.argwhere(cells), _QUANTILES, axis=0)
    v, u = ((low + high) / 2).round().astype(int)
    direction = view.crop.R_CV @ view.rays()[v, u]
    extent = float((high - low).max()) * view.stride / view.crop.focal
    return Crop.towards(direction, _MARGIN * max(extent, 4 * view.stride / view.crop.focal), CLOSE_SIZE)
