"""Tracking of the flange by the arm alone, whatever gripper it carries.

The network proposes a posture in each frame; the contours of the last links on edges of the image decide. Looks differ
from those that the network was trained on, so the arm is followed from the frames where its contours lie best into
their neighbours, which needs no network. The last link is nearly round: its turn comes from its grip, which stands out
on one side, and from all frames together, as the optical flow of its surface shows how it turns between them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, pose_difference
from kinebench_drake.grounding.crop import CLOSE_SIZE, WRIST_CENTRE_H, WRIST_RADIUS_M, Crop
from kinebench_drake.grounding.localization import find_region
from kinebench_drake.grounding.pose import FramePose
from kinebench_drake.grounding.registration.arm_fit import FOLLOWED_REACHES_PX, LAST_LINKS, ArmFit, ArmFitter
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.chain_fit import MIN_FLANGE_CELLS, UNKNOWNS, ChainFitter, ChainModel, misfit
from kinebench_drake.grounding.registration.correspondences import Correspondences
from kinebench_drake.grounding.registration.edges import EdgeMatcher, GradientImage
from kinebench_drake.grounding.registration.fit import HandFit
from kinebench_drake.grounding.registration.flange_shape import OPENINGS, FlangeShape, robotiq_shape
from kinebench_drake.grounding.registration.flow import follow_surface
from kinebench_drake.grounding.registration.solver import Solution
from kinebench_drake.grounding.tracker import Tracking
from kinebench_drake.grounding.turn import OFFSETS_RAD, TURNS_RAD, likeliest_turns
from kinebench_drake.grounding.view import DenseEstimator, Frames, GripperView
from kinebench_drake.models.panda.robot import ARM, RobotPart
from kinebench_drake.types import NO_PRIORS, Domain, GripperKind, Priors

# Cells of a gripper are taken for a hand, and lie where the wrist is.
_SEEN = (*LAST_LINKS, RobotPart.HAND)
_MIN_CELLS = 12
_QUANTILES, _MARGIN = (5.0, 95.0), 0.8  # of the cells of the wrist; half size of its crop over their extent
_LINK_CELLS, _INDEPENDENT = 300, 30.0
_LINKS = ARM[-4:]  # links whose edges are matched
_FLANGE = (RobotPart.LINK7,)
_POINTS = 300
_REACHES_PX = (8.0, 5.0, 3.0, 2.0)  # farthest edges of the last links in successive passes
_WIDE_REACHES_PX = (14.0, 10.0, 6.0, 4.0, 3.0, 2.0)  # likewise of a gripper, which the links place only roughly
_STARTS, _START_SIGMA_RAD = 4, np.deg2rad(15.0)  # turns from which a frame is fitted with a gripper, and their prior
_SHOWN, _COARSE = 12, 3  # frames and openings that tell how a gripper is mounted
_MOUNT_GRID_RAD = np.deg2rad(np.arange(0.0, 360.0, 9.0))
_MOUNT_STEPS = (0, 5, 10, 15)  # of that grid, from panda_hand to a gripper: eighths of a turn
_MOUNT_OFFSETS_M = (0.0, 0.012)  # with and without an adapter
_MOUNTS, _CLEAR = 3, 10.0  # mounts that are fitted and compared, unless one leads by this log-likelihood
_GAIN = 0.05  # least lead of a neighbour's agreement with edges that makes its posture the better one
_LOST = 0.8  # of the agreement of a frame, below which the arm was not followed from it
_ON_EDGES, _OFF_CELLS = 15.0, 0.5  # log-likelihood of a turn per share of contours on edges, and per misfit of cells
_ON_GRIPPER = 30.0  # likewise per share of the gripper's contours, which stand out on two sides
_TURN_SIGMA_RAD = np.deg2rad(6.0)  # of the likeliest turns, before each frame is fitted once more
_SAME_M, _SAME_RAD = 0.06, np.deg2rad(20.0)  # from the chain with a free base to the arm on the base
_ON_BASE, _BASE_LOSS = 0.4, 0.1  # least agreement of an arm on the base, and its largest loss by the base
_UNSEEN_SIGMA_M = 0.1
_BEHIND_M = 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _Video:
    """Input of one call."""

    frames: Frames
    camera: Camera
    wide: Mapping[int, GripperView]
    """Views that show the whole arm, by frame number."""
    images: Sequence[GradientImage]
    fitter: ArmFitter
    shape: FlangeShape


class FlangeTracker:
    """`PoseTracker` that measures the links alone; the pose of panda_hand follows from the flange."""

    def __init__(self, estimator: DenseEstimator, gripper: GripperKind = GripperKind.NONE) -> None:
        """Track with dense estimates of `estimator`; the contours of a gripper whose shape is known count, too."""
        self._estimator, self._model, self._edges = estimator, ArmModel(), EdgeMatcher()
        self._gripper = gripper
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
        video = _Video(
            frames=frames,
            camera=camera,
            wide=wide,
            images=[GradientImage(frame, camera) for frame in frames],
            fitter=ArmFitter(camera, self._model, self._edges, places),
            shape=FlangeShape(edges=(self._edges,)),
        )
        poses = self._detect(video)
        self._spread(poses, video)
        self._turn(poses, video)
        if poses and self._gripper is GripperKind.ROBOTIQ_2F85:
            video = replace(video, shape=self._mount(poses, video))
            self._fit_gripper(poses, video)
            self._spread(poses, video)
            self._turn(poses, video)
        return Tracking(
            poses=tuple(poses.get(i) for i in range(len(frames))),
            wide=tuple(wide[i] for i in range(len(frames))),
            robot=wide[0].to_frame(wide[0].part > 0, camera),
            domain=Domain.ARM,
        )

    def _detect(self, video: _Video) -> dict[int, FramePose]:
        """Return the poses of the frames that show the last links, each by itself."""
        crops = {i: crop for i, view in video.wide.items() if (crop := _wrist_crop(view)) is not None}
        for i, view in self._estimator.estimate(video.frames, video.camera, dict(crops)):
            chain = self._chain.fit(_link_cells(view, video.wide[i]))
            if chain is not None:
                crops[i] = _crop_at(chain.model.X_CH[0])
        poses = {}
        for i, view in self._estimator.estimate(video.frames, video.camera, crops):
            cells = _link_cells(view, video.wide[i])
            chain = self._chain.fit(cells)
            sharp = None if chain is None else self._sharpen(chain.model, cells, video.images[i], video.shape)
            if sharp is not None:
                poses[i] = self._pose(sharp, video.images[i], view, video.shape)
        return poses

    def _spread(self, poses: dict[int, FramePose], video: _Video) -> None:
        """Take the arm from the surest frames to their neighbours, where its contours then lie better on edges."""
        waiting = set(video.wide)
        while rest := waiting & poses.keys():
            i = max(rest, key=lambda k: _agreement(poses[k]))
            waiting.remove(i)
            for k in {i - 1, i + 1} & waiting:
                proposed = [poses.get(k), self._follow(poses[i], video.images[i], video.images[k], video.shape)]
                if _agreement(proposed[1]) < _LOST * _agreement(poses[i]):
                    proposed.append(self._detect_near(poses[i], k, video))
                best = max(proposed, key=_agreement)
                if best is not None and _agreement(best) > _agreement(proposed[0]) + _GAIN:
                    poses[k] = best

    def _follow(
        self, near: FramePose, before: GradientImage, after: GradientImage, shape: FlangeShape
    ) -> FramePose | None:
        """Return the pose of a frame by the surface of the arm, followed from a neighbouring frame."""
        moved = self._move(self._chain_of(near), before, after)
        chain = None if moved is None else self._sharpen(*moved, after, shape, FOLLOWED_REACHES_PX)
        return None if chain is None else self._pose(chain, after, near.view, shape)

    def _move(
        self, start: ChainModel, before: GradientImage, after: GradientImage
    ) -> tuple[ChainModel, Correspondences] | None:
        """Return a chain moved to the next image by the points of its surface there, and these points."""
        points = follow_surface(self._edges.caster, start.place().X_CP[0], before, after)
        moved = None if points is None else self._chain.refit(start, points)
        return None if points is None or moved is None else (moved.model, points)

    def _detect_near(self, near: FramePose, number: int, video: _Video) -> FramePose | None:
        """Return the pose of a frame by its cells, from crop and posture of a neighbouring frame."""
        crop = {number: _crop_at(near.X_CH)}
        ((_, view),) = self._estimator.estimate(video.frames, video.camera, crop)
        cells, image = _link_cells(view, video.wide[number]), video.images[number]
        start = self._chain.refit(self._chain_of(near), cells)
        chain = None if start is None else self._sharpen(start.model, cells, image, video.shape)
        return None if chain is None else self._pose(chain, image, view, video.shape)

    def _mount(self, poses: Mapping[int, FramePose], video: _Video) -> FlangeShape:
        """Return the gripper as it is likeliest mounted, by the frames whose contours lie best on edges."""
        shapes = [robotiq_shape(0.0, offset_m, _COARSE) for offset_m in _MOUNT_OFFSETS_M]
        total = np.zeros((len(_MOUNT_STEPS), len(shapes)))
        shown = sorted(poses, key=lambda k: -_agreement(poses[k]))[:_SHOWN]
        for i in shown:
            pose, image = poses[i], video.images[i]
            X_CP = self._chain.turned(self._chain_of(pose), _MOUNT_GRID_RAD).place().X_CP
            by_link = self._log_likelihood(X_CP, pose, pose.view, image, video.shape)
            for k, shape in enumerate(shapes):
                # After half a turn the gripper looks alike.
                half = [shape.gripper_agreement(image, X).max() for X in X_CP[: len(X_CP) // 2]]
                by_gripper = _ON_GRIPPER * _agreement(pose) * np.array([*half, *half])
                total[:, k] += [logsumexp(by_link + np.roll(by_gripper, -step)) for step in _MOUNT_STEPS]
        likeliest = np.argsort(-total, axis=None)[:_MOUNTS]
        likeliest = likeliest[total.flat[likeliest] > total.max() - _CLEAR]
        turn, offset = np.unravel_index(likeliest, total.shape)
        mounted = [
            replace(video, shape=robotiq_shape(_MOUNT_GRID_RAD[_MOUNT_STEPS[t]], _MOUNT_OFFSETS_M[o]))
            for t, o in zip(turn, offset, strict=True)
        ]
        if len(mounted) == 1:
            return mounted[0].shape
        return max(mounted, key=lambda tried: self._support({i: poses[i] for i in shown}, tried)).shape

    def _support(self, poses: dict[int, FramePose], video: _Video) -> float:
        """Return the log-likelihood of a gripper by frames that are fitted with it."""
        self._fit_gripper(poses, video)
        support = 0.0
        for i, pose in poses.items():
            X_CP = self._chain_of(pose).place().X_CP
            on_gripper = video.shape.gripper_agreement(video.images[i], X_CP[0]).max()
            on_edges = _agreement(pose) * (_ON_EDGES + _ON_GRIPPER * on_gripper)
            support += float(on_edges - _OFF_CELLS * _off_cells(pose.view, X_CP)[0])
        return support

    def _fit_gripper(self, poses: dict[int, FramePose], video: _Video) -> None:
        """Fit each frame anew with the contours of the gripper, from the likeliest turns of the last joint."""
        coarse = replace(video.shape, edges=video.shape.edges[:: OPENINGS // 2])
        crops = {i: _crop_at(pose.X_CH) for i, pose in poses.items()}
        for i, view in self._estimator.estimate(video.frames, video.camera, crops):
            image, chain, cells = video.images[i], self._chain_of(poses[i]), _link_cells(view, video.wide[i])
            turned = self._chain.turned(chain, TURNS_RAD).place().X_CP
            best = -np.inf
            for k in _peaks(self._log_likelihood(turned, poses[i], view, image, coarse))[:_STARTS]:
                start = self._chain.turned(chain, TURNS_RAD[k : k + 1], _START_SIGMA_RAD)
                fit = self._sharpen(start, cells, image, video.shape, _WIDE_REACHES_PX)
                if fit is None:
                    continue
                pose = self._pose(fit, image, view, video.shape)
                value = _ON_EDGES * _agreement(pose) - _OFF_CELLS * _off_cells(view, fit.model.place().X_CP)[0]
                if value > best:
                    best, poses[i] = value, pose

    def _turn(self, poses: dict[int, FramePose], video: _Video) -> None:
        """Turn the last joint as contours and cells of the last link are likeliest along the whole video."""
        crops = {i: _crop_at(pose.X_CH) for i, pose in poses.items()}
        views = dict(self._estimator.estimate(video.frames, video.camera, crops))
        chains = {i: self._chain_of(pose) for i, pose in poses.items()}
        turns, sigma = np.zeros(len(video.images)), np.zeros(len(video.images))
        for grid in (TURNS_RAD, OFFSETS_RAD):
            log_likelihood = np.zeros((len(turns), len(grid)))
            for i, view in views.items():
                shape = video.shape.at_likeliest(video.images[i], chains[i].place().X_CP[0])
                turned = self._chain.turned(chains[i], turns[i] + grid).place().X_CP
                log_likelihood[i] = self._log_likelihood(turned, poses[i], view, video.images[i], shape)
            changes = self._turn_changes(chains, video.images) - np.diff(turns)
            offsets, own_sigma = likeliest_turns(grid, log_likelihood, changes)
            turns, sigma = turns + offsets, np.maximum(sigma, own_sigma)
            chains = {i: self._chain.turned(chain, turns[i : i + 1]) for i, chain in chains.items()}
        for i, view in views.items():
            start = self._chain.turned(chains[i], turns[i : i + 1], _TURN_SIGMA_RAD)
            cells, reaches_px = _link_cells(view, video.wide[i]), _REACHES_PX[0 if video.shape.gripper else -2 :]
            chain = self._sharpen(start, cells, video.images[i], video.shape, reaches_px)
            if chain is not None:
                pose = self._pose(chain, video.images[i], view, video.shape)
                based = None if video.shape.gripper else self._on_base(pose, i, video)
                poses[i] = _with_turn_sigma(based or pose, sigma[i])

    def _log_likelihood(
        self, X_CP: Array, pose: FramePose, view: GripperView, image: GradientImage, shape: FlangeShape
    ) -> Array:
        """Return the log-likelihoods (M,) of poses of the parts (M, PARTS, 4, 4) by what turns with the last joint."""
        on_edges = _ON_EDGES * np.array([self._edges.agreement(image, X, _FLANGE) for X in X_CP])
        if shape.gripper:
            on_edges += _ON_GRIPPER * np.array([shape.gripper_agreement(image, X).max() for X in X_CP])
        return np.asarray(_agreement(pose) * on_edges - _OFF_CELLS * _off_cells(view, X_CP))

    def _turn_changes(self, chains: Mapping[int, ChainModel], images: Sequence[GradientImage]) -> Array:
        """Return the changes (T - 1,) of the last joint from frame to frame by the surface of the arm [rad]; or NaN.

        The surface carries the last link itself: errors of the links before it, which differ between frames, cancel.
        """
        changes = np.full(len(images) - 1, np.nan)
        for i in chains.keys() & {k - 1 for k in chains}:
            moved, after = self._move(chains[i], images[i], images[i + 1]), chains[i + 1]
            if moved is not None:
                R = after.X_CH[0, :3, :3].T @ moved[0].X_CH[0, :3, :3]
                turn = np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])
                changes[i] = (after.q[0, -1] + turn - chains[i].q[0, -1] + np.pi) % (2 * np.pi) - np.pi
        return changes

    def _on_base(self, pose: FramePose, number: int, video: _Video) -> FramePose | None:
        """Return a pose that the base of the camera confirms, with the arm on it; None if it does not."""
        links = _link_cells(pose.view, video.wide[number])
        image = video.images[number]
        arm = video.fitter.at([number]).fit_links(pose.X_CH, _TURN_SIGMA_RAD, links, image)
        if arm is None or arm.edge_agreement < max(_ON_BASE, _agreement(pose) - _BASE_LOSS):
            return None
        distance, angle = pose_difference(arm.X_CH, pose.X_CH)
        if distance > _SAME_M or angle > _SAME_RAD:
            return None
        return replace(pose, X_CH=arm.X_CH, arm=arm, overlap=arm.edge_agreement)

    def _chain_of(self, pose: FramePose) -> ChainModel:
        """Return the chain of a pose."""
        if pose.arm is None:
            raise ValueError("a pose of the flange has a posture")
        return self._chain.at(pose.X_CH, pose.arm.q)

    def _sharpen(
        self,
        start: ChainModel,
        points: Correspondences,
        image: GradientImage,
        shape: FlangeShape,
        reaches_px: Sequence[float] = _REACHES_PX,
    ) -> Solution[ChainModel] | None:
        """Fit a chain to points of the links and to edges together; None if it diverges or no edges are near."""
        chain, (matcher,) = None, shape.at_likeliest(image, start.place().X_CP[0]).edges
        for reach_px in reaches_px:
            model = start if chain is None else chain.model
            edges = matcher.match(image, model.place().X_CP[0], reach_px, (*_LINKS, *shape.gripper), _POINTS)
            if edges is None:
                break
            depth = None if chain is None else chain.log_depth_factor
            chain = self._chain.refit(model, Correspondences.join([points, edges]), depth) or chain
        return chain

    def _pose(
        self, chain: Solution[ChainModel], image: GradientImage, view: GripperView, shape: FlangeShape
    ) -> FramePose:
        """Return the pose of a frame; in place of a hand it has the last link and the residual of the chain."""
        flange = view.part == RobotPart.LINK7
        X_CP, unknown = _without_upper_arm(chain.model.place().X_CP[0]), float("nan")
        (matcher,) = shape.at_likeliest(image, X_CP).edges
        arm = ArmFit(
            q=chain.model.q[0],
            X_CH=chain.model.X_CH[0],
            finger_m=unknown,
            finger_sigma_m=unknown,
            agrees=False,
            consistency_px=unknown,
            scale=unknown,
            evidence=0.0,
            covariance=np.asarray(np.linalg.inv(chain.information[0] + 1e-6 * np.eye(UNKNOWNS))[:6, :6]),
            edge_agreement=matcher.agreement(image, X_CP, shape.wrist),
            hand_agreement=matcher.agreement(image, X_CP, shape.flange),
        )
        hand = HandFit(
            X_CH=arm.X_CH,
            finger_m=unknown,
            finger_free=False,
            finger_sigma_m=unknown,
            depth_factor=float(np.exp(chain.log_depth_factor[0])),
            residual=chain.growth(0),
            points=int(flange.sum()),
            sigma_m=float(np.median(view.coordinates_sigma_m[flange])) if flange.any() else _UNSEEN_SIGMA_M,
            covariance=arm.covariance,
        )
        return FramePose(
            X_CH=arm.X_CH,
            finger_m=unknown,
            finger_sigma_m=unknown,
            hand=hand,
            hand_without_silhouette=hand,
            arm=arm,
            view=view,
            overlap=arm.edge_agreement,
        )


def _agreement(pose: FramePose | None) -> float:
    return 0.0 if pose is None or pose.arm is None else pose.arm.edge_agreement


def _off_cells(view: GripperView, X_CP: Array) -> Array:
    """Return the misfit (M,) of the cells of the last link, with parts at `X_CP` (M, PARTS, 4, 4); 0 without cells."""
    cells = Correspondences.of_view(view, view.part == RobotPart.LINK7, _LINK_CELLS, _INDEPENDENT)
    return misfit(cells, X_CP[:, RobotPart.LINK7]) if len(cells) >= MIN_FLANGE_CELLS else np.zeros(len(X_CP))


def _peaks(values: Array) -> list[int]:
    """Return the numbers of the local maxima of `values` (N,), highest first."""
    padded = np.pad(values, 1, constant_values=-np.inf)
    peak = (values >= padded[:-2]) & (values > padded[2:])
    return sorted(np.flatnonzero(peak).tolist(), key=lambda k: -values[k])


def _without_upper_arm(X_CP: Array) -> Array:
    """Return poses (..., PARTS, 4, 4) with all links before the last ones behind the camera.

    Without a base their postures are hardly known, and one that hides a bad contour must not look better.
    """
    X_CP = X_CP.copy()
    X_CP[..., ARM[: -len(LAST_LINKS)], :3, 3] = [0.0, 0.0, -_BEHIND_M]
    return X_CP


def _with_turn_sigma(pose: FramePose, sigma_rad: float) -> FramePose:
    """Return a pose whose covariance includes a standard deviation of its turn about the flange's axis."""
    if pose.arm is None:
        return pose
    covariance, axis = pose.arm.covariance.copy(), pose.X_CH[:3, 2]
    covariance[:3, :3] += sigma_rad**2 * np.outer(axis, axis)
    hand = replace(pose.hand, covariance=covariance)
    arm = replace(pose.arm, covariance=covariance)
    return replace(pose, arm=arm, hand=hand, hand_without_silhouette=hand)


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
