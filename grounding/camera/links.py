"""Calibration of a static camera from the links of the arm alone, at known joint angles, whatever gripper it carries.

Most cells of an unfamiliar robot may be wrong, but all frames have one camera: random-sample consensus over all of them
gives initial cameras, and the contours of the links decide between these, between shapes of a pixel, and between lags
of the joint angles.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.errors import UnmeasurableError
from kinebench_drake.geometry import Array
from kinebench_drake.grounding import bounds
from kinebench_drake.grounding.camera.bundle_adjustment import ArmScene, Prior
from kinebench_drake.grounding.camera.camera_estimate import CameraEstimate
from kinebench_drake.grounding.camera.candidate import (
    LOG_FOCAL_SIGMA,
    MIDDLE,
    CameraCandidate,
    CandidateFitter,
    ContourImages,
    Passes,
)
from kinebench_drake.grounding.camera.detections import (
    MIN_FRAMES,
    ArmDetections,
    CalibrationCorrespondences,
    find_links,
)
from kinebench_drake.grounding.camera.estimate import JOINT_SIGMA_RAD
from kinebench_drake.grounding.camera.lens import USUAL_FOV_DEG, Lens, focal_px, solve_pnp, with_focal
from kinebench_drake.grounding.camera.states import RobotStates
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.grounding.registration.edges import FIT_POINTS, EdgeMatcher, unknown_gripper
from kinebench_drake.grounding.tracking.estimator import NetworkEstimator
from kinebench_drake.grounding.tracking.view import DenseEstimator
from kinebench_drake.io.frames import Frames
from kinebench_drake.io.jsonl import Json
from kinebench_drake.io.progress import count_steps
from kinebench_drake.models.panda.description import ARM, GRIPPER, LINK_OF, GripperKind, RobotPart
from kinebench_drake.models.perception.network import WEIGHTS_OF, load_network
from kinebench_drake.segments import evenly, finite_rows

MAX_LAG = 3
"""Greatest lag of joint angles that is tried [frames]."""
_FRAMES_A_LAG = 8
"""Frames of a video for each frame of lag that is tried, so that enough remain."""
_FOV_DEG = (45.0, 60.0, 75.0, 90.0, 105.0)
"""Fields of view along the longer side at which the search starts [degrees]."""
_USUAL_FOCAL = (0.25, 3.0)
"""Focal lengths of usual lenses over the longer side of the picture: fields of view of 127 to 19 degrees."""
_VIEW_FOV_DEG = (USUAL_FOV_DEG, 90.0)
"""Fields of view along the longer side that the views of the networks assume [degrees]."""
_LINK_CELLS = 250
"""Greatest number of cells of a link that a consensus is sought in."""
_SAMPLES = 500
"""Samples of a consensus: a third of the cells may be right."""
_STARTED_FRAMES = 8
"""Frames in which initial cameras are compared."""
_COMPARED_FRAMES = 12
"""Frames in which lags and shapes of a pixel are compared."""
_PASSES = ((14.0, 1.0), (10.0, 0.6), (6.0, 0.3), (4.0, 0.1))
"""Reaches of the search for edges of an initial camera [px of an image of at most 640 px], and weights of the cells."""
_LAG_PASSES = ((5.0, 0.0),)
"""Reach of the search for edges at each lag [px of an image of at most 640 px], without cells."""
_LAG_JOINT_SIGMA_RAD = 1e-3
"""Standard deviation of joint angles where lags are compared: free ones would hide a lag [rad]."""
LEAST_LEAD = 0.03
"""Least lead of the agreement of the moving links at their lag over that at other lags."""
_LEAD_SIGMAS = 3.0
"""Standard errors of the frames by which a stated motion leads."""
_JUDGED_FRAMES = 8
"""Least number of frames with links by which a motion is judged."""
_SEEN_CELLS = 20
"""Cells of a link in a frame from which on it counts as seen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LagEstimate:
    """Lag of joint angles against a video."""

    frames: float
    """Frame k shows the joint angles of row k + `frames`: positive where the rows are late."""
    agreement: float
    """Mean share of the contours of links 1 to 7 on image edges at this lag, joint angles kept."""
    runner_up: float | None
    """The greatest at lags that differ by a frame or more; None if no other was tried."""

    @property
    def is_determined(self) -> bool:
        """Whether the agreement leads that at other lags, if any was tried."""
        return self.runner_up is None or self.agreement - self.runner_up >= LEAST_LEAD


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkEvidence:
    """What was estimated besides a camera that is fitted to links."""

    lag: LagEstimate
    shapes: tuple[tuple[float, float], ...]
    """Ratios fy / fx that were tried, each with the agreement of its camera, the one used first."""
    links: str
    """Links that the network sees, with the number of frames."""
    unused: tuple[float, float] | None = None
    """Agreement of the moving links in frames that the fit did not use, and the same with their joint angles exchanged;
    None without such frames."""

    def require_agreement(self, source: str, agreement: float) -> None:
        """Check the share of the contours of the links on image edges, and its lead in frames that the fit did not use.

        Without such frames the lead is that over other lags.

        Raises:
            UnmeasurableError: no camera agrees with the links, or they agree as much with other joint angles.
        """
        if agreement < bounds.AGREEMENT:
            raise UnmeasurableError(
                f"{source}: with no camera do the links of the arm lie on the edges of the images ({agreement:.0%} of "
                f"their contours do, at least {bounds.AGREEMENT:.0%} are needed); the links seen are {self.links}; "
                "needed are two or more links of a moving Panda, a static camera without distortion, and the joint "
                "angles of these frames, in radians"
            )
        if self.unused is None and not self.lag.is_determined:
            raise UnmeasurableError(
                f"{source}: the links agree with the images as much at other times ({self.lag.agreement:.0%} and "
                f"{self.lag.runner_up:.0%} of the contours of moving links on edges): the arm hardly moves, or the "
                f"camera is wrong; the links seen are {self.links}"
            )
        if self.unused is not None and self.unused[0] - self.unused[1] < bounds.LEAD:
            raise UnmeasurableError(
                f"{source}: in frames that were not used the links agree no better with their own joint angles than "
                f"with others ({self.unused[0]:.0%} and {self.unused[1]:.0%} of the contours of moving links on "
                f"edges): the camera is wrong; the links seen are {self.links}"
            )

    def to_json(self) -> dict[str, Json]:
        """Serialize all results."""
        return {
            "seen": self.links,
            "lag_frames": self.lag.frames,
            "lag_agreement": self.lag.agreement,
            "lag_runner_up": self.lag.runner_up,
            "unused_frames": None if self.unused is None else list(self.unused),
            "fy_over_fx": [{"ratio": ratio, "agreement": agreement} for ratio, agreement in self.shapes],
        }

    def format_lines(self) -> list[str]:
        """Format the results as lines of text."""
        lag = self.lag
        when = f"{abs(lag.frames):g} frames {'late' if lag.frames > 0 else 'early'}" if lag.frames else "in time"
        others = "no other was tried" if lag.runner_up is None else f"{lag.runner_up:.0%} at other lags"
        shapes = [f"{ratio:.3f} ({agreement:.0%} of the contours)" for ratio, agreement in self.shapes]
        return [
            f"fitted to the links alone: {self.links}",
            f"joint angles: {when} ({lag.agreement:.0%} of the contours of moving links on edges, {others})",
            f"fy / fx: {', against '.join(shapes)}",
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkAgreement:
    """Agreement of the moving links with frames to which the camera was not fitted, at stated and at other motions."""

    own: Array
    """(T,) share of their contours on image edges in the stated postures; 0 where no link is visible."""
    controls: Mapping[str, Array]
    """(T,) the same in other postures."""

    @property
    def means(self) -> dict[str, float]:
        """Mean shares over the frames that show links, of the stated motion as `own`, and of each control."""
        shares = {"own": self.own, **self.controls}
        return {name: float(values[values > 0].mean()) if values.any() else 0.0 for name, values in shares.items()}

    def decide(self) -> tuple[bool | None, str]:
        """Return True and a reason where the stated motion leads every control clearly, and in no third falls behind.

        Else None: links that do not agree may be badly visible.
        """
        means = self.means
        text = ", ".join(f"{name} {mean:.0%}" for name, mean in means.items())
        reason = f"contours of the links on edges in {len(self.own)} frames: {text}"
        visible = np.flatnonzero(self.own)
        if len(visible) < _JUDGED_FRAMES:
            return None, f"{reason}; {_JUDGED_FRAMES} frames that show them are needed"
        for name, values in self.controls.items():
            lead = (self.own - values)[visible]
            least = max(LEAST_LEAD, _LEAD_SIGMAS * float(lead.std()) / np.sqrt(len(lead)))
            thirds = [float(part.mean()) for part in np.array_split(lead, 3)]
            if means["own"] - means[name] < least or min(thirds) < -LEAST_LEAD:
                return None, f"{reason}; {name} actions do not agree clearly less, by {least:.0%} and in each third"
        return True, reason


@dataclass(frozen=True)
class _LinkFrames:
    """Links in some frames of a video, with the joint angles by lag."""

    robot: ArmDetections
    states: RobotStates
    """States in all frames of the video."""
    images: ContourImages
    fitter: CandidateFitter

    def q(self, lag: float) -> Array:
        """Return the joint angles (T, 7) at a lag [rad]."""
        return self.states.q_at_lag(lag)[self.robot.rows]

    def locate(self, cells: CalibrationCorrespondences, lag: float) -> Array:
        """Return the points (N, 3) of cells in B at a lag [m]."""
        return cells.locate(self.fitter.model.poses(self.q(lag)), self.robot.finger_m)

    def candidate(self, lens: Lens, lag: float) -> CameraCandidate:
        """Return a lens at a lag as a candidate in all frames."""
        scene = ArmScene(lens=lens, q=self.q(lag), finger_m=self.robot.finger_m)
        costs = np.zeros(len(scene.q))
        return CameraCandidate(scene=scene, rows=np.arange(len(costs)), cells=self.robot.cells, costs=costs, cost=0.0)

    def find_starts(self, cameras: Sequence[Camera], lags: Sequence[float]) -> list[tuple[Lens, float]]:
        """Return initial lenses of some intrinsics, each at the lag at which most cells agree."""
        cells = self.robot.cells
        points = {lag: self.locate(cells, lag) for lag in lags}
        starts = []
        for camera in cameras:
            solutions = [(solve_pnp(p_B, cells.uv_px, camera, _SAMPLES), lag) for lag, p_B in points.items()]
            solved = [(*solution, lag) for solution, lag in solutions if solution is not None]
            if solved:
                X_CB, _, lag = max(solved, key=lambda one: one[1])
                starts.append((Lens(intrinsics=camera, X_CB=X_CB), lag))
        return starts

    def fit(
        self, lens: Lens, lag: float, prior: Prior, frames: int = _COMPARED_FRAMES, passes: Passes = _PASSES
    ) -> CameraCandidate:
        """Return a lens after a fit to the contours of some of the frames."""
        rows = evenly(len(self.robot.rows), frames)
        start = self.candidate(lens, lag).take(rows)
        fit = self.fitter.fit(start, self.images.take(rows), replace(prior, lens=lens), passes)
        return fit if _is_usual(fit.scene.lens.intrinsics) else replace(fit, agreement=0.0)

    def find_lag(self, lens: Lens, lags: Sequence[float], prior: Prior) -> LagEstimate:
        """Return the lag at which the contours of the moving links agree best, after a fit at each of some `lags`.

        The frames are those in which the joints move most.
        """
        turn_rad = np.linalg.norm(self.q(lags[-1]) - self.q(lags[0]), axis=1)
        rows = np.sort(np.argsort(-turn_rad, kind="stable")[:_COMPARED_FRAMES])
        images = self.images.take(rows)
        moving = images.without(*GRIPPER, RobotPart.LINK0)
        prior = replace(prior, lens=lens, joint_sigma_rad=_LAG_JOINT_SIGMA_RAD)
        agreements: dict[float, float] = {}

        def agree(lag: float) -> float:
            if lag not in agreements:
                fit = self.fitter.fit(self.candidate(lens, lag).take(rows), images, prior, _LAG_PASSES)
                agreements[lag] = float(moving.agreement(fit.scene).mean())
            return agreements[lag]

        best = max(count_steps(lags, "lags compared", len(lags)), key=agree)
        halves = [best + half for half in (-0.5, 0.5) if lags[0] <= best + half <= lags[-1]]
        best = max((best, *halves), key=agree)
        others = [agreement for other, agreement in agreements.items() if abs(other - best) >= 1.0]
        return LagEstimate(frames=best, agreement=agreements[best], runner_up=max(others, default=None))


class LinkCalibrator:
    """Calibration from links; one instance serves any number of videos."""

    def __init__(self, estimator: DenseEstimator) -> None:
        """Calibrate with the dense estimates of `estimator`.

        Raises:
            SetupError: meshes, native libraries or the robot description are missing.
        """
        body = unknown_gripper()
        self._estimator = estimator
        self._fitter = CandidateFitter(ArmModel(body), EdgeMatcher(body))

    @classmethod
    def load(cls, gripper: GripperKind) -> "LinkCalibrator":
        """Return a calibrator with the network for arms with a gripper.

        Raises:
            SetupError: weights, meshes or native libraries are missing.
        """
        return cls(NetworkEstimator(load_network(WEIGHTS_OF[gripper])))

    def detect(
        self,
        frames: Frames,
        states: RobotStates,
        guess: Camera,
        *,
        focal_free: bool,
        most: int,
        allowed: NDArray[np.intp] | None = None,
    ) -> list[ArmDetections]:
        """Return the links in the best of the frames (T, H, W, 3) whose joint angles are known at all lags.

        Of these only frames `allowed` (N,) are used; None: any.

        Of an unknown focal length several are assumed, one after the other: views of a wide camera look stretched with
        that of a narrow one.

        Raises:
            UnmeasurableError: they are seen in too few frames.
        """
        ends = [finite_rows(states.q_at_lag(lag)) for lag in (-_most_lag(states), _most_lag(states))]
        side = max(guess.width, guess.height)
        cameras = [with_focal(guess, focal_px(side, fov)) for fov in _VIEW_FOV_DEG] if focal_free else [guess]
        rows = np.flatnonzero(ends[0] & ends[1])
        rows = rows if allowed is None else np.intersect1d(rows, allowed)
        return [find_links(self._estimator, frames, rows, camera, most) for camera in cameras]

    def solve(
        self,
        detected: Sequence[ArmDetections],
        frames: Frames,
        states: RobotStates,
        guess: Camera,
        *,
        focal_free: bool,
        shapes: Sequence[float],
        centre_sigma_px: float,
    ) -> tuple[CameraEstimate, LinkEvidence]:
        """Fit a camera to links at known joint angles.

        Args:
            detected: links in some of the frames, by assumed camera.
            frames: (T, H, W, 3) frames of the video.
            states: robot states in these frames.
            guess: initial intrinsics.
            focal_free: True to estimate the focal length.
            shapes: ratios fy / fx of the focal lengths that are tried.
            centre_sigma_px: standard deviation of the principal point [px]; 0 for a fixed one.

        Raises:
            UnmeasurableError: no camera agrees with the links.
        """
        prior = Prior(
            lens=Lens(intrinsics=guess, X_CB=np.eye(4)),
            log_focal_sigma=LOG_FOCAL_SIGMA if focal_free else 0.0,
            joint_sigma_rad=JOINT_SIGMA_RAD,
        )
        lags = [float(lag) for lag in range(-_most_lag(states), _most_lag(states) + 1)]
        coarse_lags = [lag for lag in lags if lag % 2 == 0]
        side = max(guess.width, guess.height)
        cameras = [with_focal(guess, focal_px(side, fov)) for fov in _FOV_DEG] if focal_free else [guess]
        cameras = [replace(camera, fy=camera.fx * shapes[0]) for camera in cameras]
        fits = []
        for robot in count_steps(detected, "views compared", len(detected)):
            X_BP = self._fitter.model.poses(states.q[robot.rows])
            images = replace(self._fitter.images(frames[robot.rows], guess), left_out=GRIPPER, points=FIT_POINTS)
            links = _LinkFrames(balanced(robot, X_BP), states, images, self._fitter)
            starts = links.find_starts(cameras, coarse_lags)
            fits += [(links.fit(*start, prior, _STARTED_FRAMES), links, robot) for start in starts]
        if not fits:
            raise UnmeasurableError(f"no camera agrees with the cells of the links ({describe_links(detected[0])})")
        fit, links, robot = max(fits, key=lambda one: one[0].agreement)
        lag = links.find_lag(fit.scene.lens, coarse_lags, prior)
        stretched = [links.fit(_stretched(fit.scene.lens, shape), lag.frames, prior) for shape in shapes]
        stretched = [links.fit(fit.scene.lens, lag.frames, prior, len(robot.rows), MIDDLE) for fit in stretched]
        # The likeliest shape stays unless another leads clearly: how fits converge changes agreements, too.
        best = max(stretched, key=lambda fit: fit.agreement + (bounds.LEAD if fit is stretched[0] else 0.0))
        stretched = [best, *sorted((fit for fit in stretched if fit is not best), key=lambda fit: -fit.agreement)]
        lens = stretched[0].scene.lens
        lag = links.find_lag(lens, lags, prior)
        candidate = links.candidate(lens, lag.frames)
        total = int((links.images.agreement(candidate.scene) > 0).sum())
        free = replace(prior, lens=lens, centre_sigma_px=centre_sigma_px)
        estimate = self._fitter.finish(candidate, links.images, free, max(total, MIN_FRAMES))
        if not _is_usual(estimate.camera):
            estimate = replace(estimate, agreement=0.0)
        ratios = [(fit.scene.lens.intrinsics.fy / fit.scene.lens.intrinsics.fx, fit.agreement) for fit in stretched]
        evidence = LinkEvidence(
            lag=lag,
            shapes=tuple(ratios),
            links=describe_links(robot),
            unused=self._agree_unused(frames, states.q_at_lag(lag.frames), robot.rows, estimate.scene.lens),
        )
        return replace(estimate, frames=links.robot.rows[estimate.frames]), evidence

    def _agree_unused(self, frames: Frames, q: Array, used: NDArray[np.intp], lens: Lens) -> tuple[float, float] | None:
        """Return agreements in unused frames, joint angles `q` (T, 7) theirs and exchanged; None without any."""
        rows = np.setdiff1d(np.flatnonzero(finite_rows(q)), used)
        if len(rows) < MIN_FRAMES:
            return None
        rows = rows[evenly(len(rows), _COMPARED_FRAMES)]
        agreements = self.compare(frames[rows], lens, [q[rows], q[np.roll(rows, len(rows) // 2)]])
        own, exchanged = (float(shares[shares > 0].mean()) if shares.any() else 0.0 for shares in agreements)
        return own, exchanged

    def compare(self, frames: Frames, lens: Lens, postures: Sequence[Array]) -> Array:
        """Return the shares (K, T) of the contours of the moving links on edges of frames (T, H, W, 3).

        Each of the K `postures` has joint angles (T, 7) [rad]. The share is 0 where no link is visible.
        """
        images = self._fitter.images(frames, lens.intrinsics)
        images = replace(images, left_out=(*GRIPPER, RobotPart.LINK0), points=FIT_POINTS)
        return np.array([images.agreement(ArmScene(lens=lens, q=q, finger_m=np.zeros(len(q)))) for q in postures])


def _is_usual(camera: Camera) -> bool:
    """Return whether the focal length is one of a usual lens: any contours agree with a view that has nearly none."""
    return _USUAL_FOCAL[0] < camera.fx / max(camera.width, camera.height) < _USUAL_FOCAL[1]


def _stretched(lens: Lens, shape: float) -> Lens:
    """Return a lens with another ratio fy / fx."""
    return replace(lens, intrinsics=replace(lens.intrinsics, fy=lens.intrinsics.fx * shape))


def _most_lag(states: RobotStates) -> int:
    """Return the greatest lag that is tried in a video of so many states [frames]."""
    return min(MAX_LAG, len(states.q) // _FRAMES_A_LAG)


def balanced(robot: ArmDetections, X_BP: Array) -> ArmDetections:
    """Return detections with few cells of each link, and of a link at rest as many as of one pose.

    Poses `X_BP` (T, PARTS, 4, 4) [m] tell which links are at rest.
    """
    cells = robot.cells
    rng = np.random.default_rng(0)
    once = 1.0 / cells.count_repeats(X_BP)
    chosen = []
    for part in np.unique(cells.part):
        own = np.flatnonzero(cells.part == part)
        share = once[own] / cells.sigma_m[own]
        count = min(_LINK_CELLS, int(np.ceil(once[own].sum())))
        chosen.append(rng.choice(own, count, replace=False, p=share / share.sum()))
    return replace(robot, cells=cells.take(np.concatenate(chosen)))


def describe_links(robot: ArmDetections) -> str:
    """Describe in how many frames each link is seen."""
    counts = []
    for part in ARM:
        cells = np.bincount(robot.cells.frame[robot.cells.part == part], minlength=len(robot.rows))
        if frames := int((cells >= _SEEN_CELLS).sum()):
            counts.append(f"{LINK_OF[part].removeprefix('panda_')} in {frames}")
    return f"{', '.join(counts) or 'no link'} of {len(robot.rows)} frames"
