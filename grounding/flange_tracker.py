"""Tracking of the flange by the arm alone, whatever gripper it carries."""

import numpy as np

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.crop import CLOSE_SIZE, WRIST_CENTRE_H, WRIST_RADIUS_M, Crop
from kinebench_drake.grounding.localization import find_region
from kinebench_drake.grounding.pose import FramePose
from kinebench_drake.grounding.registration.arm_fit import (
    LAST_LINKS,
    ArmFit,
    ArmFitter,
)
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.chain_fit import UNKNOWNS, ChainFitter, ChainModel
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.edges import EdgeMatcher, GradientImage
from kinebench_drake.grounding.registration.fit import HandFit
from kinebench_drake.grounding.registration.solver import Solution
from kinebench_drake.grounding.tracker import Tracking
from kinebench_drake.grounding.view import DenseEstimator, Frames, GripperView
from kinebench_drake.models.panda.robot import ARM, RobotPart
from kinebench_drake.types import NO_PRIORS, Domain, Priors

# Cells of a gripper are taken for a hand, and lie where the wrist is.
_SEEN = (RobotPart.LINK5, *LAST_LINKS, RobotPart.HAND)
_MIN_CELLS = 12
_QUANTILES, _MARGIN = (5.0, 95.0), 0.8  # of the cells of the wrist; half size of its crop over their extent
_LINK_CELLS, _INDEPENDENT = 300, 30.0
_LINKS = ARM[-4:]  # links whose edges are matched
_POINTS = 300
_REACHES_PX = (8.0, 5.0, 3.0)  # farthest edges of the last links in successive passes
_GAIN = 0.05  # least lead of a neighbour's agreement with edges that makes its posture worth a try
_UNSEEN_SIGMA_M = 0.1
_SAME_M, _SAME_RAD = 0.06, np.deg2rad(20.0)  # from the chain with a free base to the arm on the base


class FlangeTracker:
    """`PoseTracker` that measures the links alone; the pose of panda_hand follows from the flange."""

    def __init__(self, estimator: DenseEstimator) -> None:
        """Track with dense estimates of `estimator`."""
        self._estimator, self._model, self._edges = estimator, ArmModel(), EdgeMatcher()
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
        fitter = ArmFitter(camera, self._model, self._edges, places)
        crops = {i: crop for i, view in wide.items() if (crop := _wrist_crop(view)) is not None}
        for i, view in self._estimator.estimate(frames, camera, dict(crops)):
            chain = self._chain.fit(_link_cells(view, wide[i]))
            if chain is not None:
                crops[i] = _crop_at(chain.model.X_CH[0])
        closes = dict(self._estimator.estimate(frames, camera, crops))
        images = {i: GradientImage(frames[i], camera) for i in closes}
        poses: dict[int, FramePose] = {}
        for i, close in sorted(closes.items()):
            pose = self._measure(close, wide[i], fitter.at([i]), images[i])
            if pose is not None:
                poses[i] = pose
        for step in (1, -1):
            for i in sorted(wide)[::step]:
                near = poses.get(i - step)
                if near is not None and _agreement(near) > _agreement(poses.get(i)) + _GAIN:
                    image = images.setdefault(i, GradientImage(frames[i], camera))
                    for _, close in self._estimator.estimate(frames, camera, {i: _crop_at(near.X_CH)}):
                        pose = self._measure(close, wide[i], fitter.at([i]), image, near)
                        if pose is not None and _agreement(pose) > _agreement(poses.get(i)):
                            poses[i] = pose
        return Tracking(
            poses=tuple(poses.get(i) for i in range(len(frames))),
            wide=tuple(wide[i] for i in range(len(frames))),
            robot=wide[0].to_frame(wide[0].part > 0, camera),
            domain=Domain.ARM,
        )

    def _measure(
        self,
        close: GripperView,
        wide: GripperView,
        fitter: ArmFitter,
        image: GradientImage,
        near: FramePose | None = None,
    ) -> FramePose | None:
        """Return the pose of a frame, from its cells or from the posture of a neighbouring frame; None without one."""
        cells = _link_cells(close, wide)
        if near is None or near.arm is None:
            chain = self._chain.fit(cells)
        else:
            chain = self._chain.refit(self._chain.at(near.X_CH, near.arm.q), cells)
        if chain is None:
            return None
        arm = fitter.fit_links(chain.model.X_CH[0], chain.model.q[0], cells, image)
        if arm is not None:
            distance, angle = pose_difference(arm.X_CH, chain.model.X_CH[0])
            if arm.agrees and distance <= _SAME_M and angle <= _SAME_RAD:
                return _frame_pose(arm, chain, close)
        chain = self._sharpen(chain, cells, image)
        return _frame_pose(self._free_arm(chain, image), chain, close)

    def _sharpen(
        self, chain: Solution[ChainModel], cells: Correspondences, image: GradientImage
    ) -> Solution[ChainModel]:
        """Fit the chain to cells and edges together."""
        for reach_px in _REACHES_PX:
            edges = self._edges.match(image, chain.model.place().X_CP[0], reach_px, _LINKS, _POINTS)
            if edges is None:
                break
            joined = Correspondences.join([cells, edges])
            chain = self._chain.refit(chain.model, joined, chain.log_depth_factor) or chain
        return chain

    def _free_arm(self, chain: Solution[ChainModel], image: GradientImage) -> ArmFit:
        """Return the fit of a chain whose base is not that of the camera."""
        return ArmFit(
            q=chain.model.q[0],
            X_CH=chain.model.X_CH[0],
            finger_m=float("nan"),
            finger_sigma_m=float("nan"),
            agrees=False,
            consistency_px=float("nan"),
            scale=float("nan"),
            evidence=0.0,
            covariance=np.asarray(np.linalg.inv(chain.information[0] + 1e-6 * np.eye(UNKNOWNS))[:6, :6]),
            edge_agreement=self._edges.agreement(image, chain.model.place().X_CP[0], LAST_LINKS),
        )


def _agreement(pose: FramePose | None) -> float:
    return 0.0 if pose is None or pose.arm is None else pose.arm.edge_agreement


def _link_cells(close: GripperView, wide: GripperView) -> Correspondences:
    return Correspondences.join([Correspondences.of_view(v, v.arm, _LINK_CELLS, _INDEPENDENT) for v in (close, wide)])


def _wrist_crop(view: GripperView) -> Crop | None:
    """Return the crop around the last links in a view of the whole image; None if it shows too few of their cells."""
    cells = np.isin(view.part, _SEEN)
    if cells.sum() < _MIN_CELLS:
        return None
    low, high = np.percentile(np.argwhere(cells), _QUANTILES, axis=0)
    v, u = ((low + high) / 2).round().astype(int)
    direction = view.crop.R_CV @ view.rays()[v, u]
    extent = float((high - low).max()) * view.stride / view.crop.focal
    return Crop.towards(direction, _MARGIN * max(extent, 4 * view.stride / view.crop.focal), CLOSE_SIZE)


def _crop_at(X_CH: Array) -> Crop:
    """Return the crop of the last links behind a hand at `X_CH` (4, 4)."""
    centre = X_CH[:3, :3] @ WRIST_CENTRE_H + X_CH[:3, 3]
    return Crop.towards(centre, WRIST_RADIUS_M / float(np.linalg.norm(centre)), CLOSE_SIZE)


def _frame_pose(arm: ArmFit, chain: Solution[ChainModel], close: GripperView) -> FramePose:
    """Return the pose of a frame; in place of a hand it has the last link and the residual of the free chain."""
    flange = close.part == RobotPart.LINK7
    hand = HandFit(
        X_CH=chain.model.X_CH[0],
        finger_m=float("nan"),
        finger_free=False,
        finger_sigma_m=float("nan"),
        depth_factor=float(np.exp(chain.log_depth_factor[0])),
        residual=chain.growth(0),
        points=int(flange.sum()),
        sigma_m=float(np.median(close.coordinates_sigma_m[flange])) if flange.any() else _UNSEEN_SIGMA_M,
        covariance=arm.covariance,
    )
    return FramePose(
        X_CH=arm.X_CH,
        finger_m=float("nan"),
        finger_sigma_m=float("nan"),
        hand=hand,
        hand_without_silhouette=hand,
        arm=arm,
        view=close,
        overlap=arm.edge_agreement,
    )
