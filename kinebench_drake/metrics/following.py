"""Following: how far a measured motion is from a commanded one, how late it is, how large, and from when it drifts.

Measured and commanded poses are in one frame. The commands are delayed by each of some lags. At each lag the measured
motion is fitted by the commanded one times a gain plus an offset (Huber's loss), so that neither a wrong size nor an
error of the camera is taken for a delay; the lag of the least loss is that of the clip. Deviations are taken at this
lag without fit. Frames that are lost count against the clip wherever they could decide.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import Array, interpolate_pose, invert, pose_difference, transform_points
from kinebench_drake.metrics.noise import estimate_track_noise
from kinebench_drake.segments import finite_rows, spread
from kinebench_drake.track import GripperTrack

TUBE_M = 0.02
"""Radius of the tube about the commands [m]: half a small object, beyond which a grasp misses."""
TUBE_RAD = float(np.deg2rad(10.0))
"""Angle of the tube [rad]."""
TUBE_SIGMAS = 3.0
"""Standard deviations of the tracker by which the tube is wider."""
FAR = 1.5
"""Deviation from which on a frame is clearly outside [tubes]."""
FOLLOWING_SHARE = 0.9
"""Least share of the frames inside the tube of a clip that follows; lost frames count as outside."""
FAR_SHARE = 0.3
"""Least share of the frames clearly outside, at every lag, of a clip that does not follow: thrice what is allowed."""
CONTROL_RATIO = 0.5
"""Greatest ratio of the clip's mean deviation to that of each control: commands that differ little prove little."""
_CAP = 5.0
"""Deviation at which a frame counts in such means at most, and at which a lost frame counts [tubes]."""
MIN_FRAMES = 8
"""Least number of frames to compare: fewer show no motion, and one lost frame of them is more than is allowed."""
LAGS = (-1.0, 5.0)
"""Least and greatest lag that is reported [frames]: commands are at most a frame late, models skip few frames."""
MIN_GAIN = 0.1
"""Least gain of a motion that has a lag: a clip that rests, or moves the other way, has none."""
_LAG_STEP = 0.1
"""Step of the search [frames]: a fifth of the error that is allowed."""
LEAD = 0.2
"""Least share by which the loss at the lag is below those a frame away; else all lags fit alike."""
_HUBER_M = 0.01
"""Residual from which on the loss of a fit grows linearly [m]: beyond the errors of a tracked frame."""
_FITS = 5
"""Reweighted fits; the gain changes by less than 0.1 % afterwards."""
_LEVER_M = 0.1
"""Distance at which a rotation counts as a motion, that from hand to TCP [m]."""
MIN_MOTION_M = 0.02
"""Standard deviation of the commanded positions below which there is no gain: that of a motion of some 5 cm [m]."""
DRIFT_M = 0.01
"""Radius of the tube that a clip leaves for good where its drift begins [m]: thrice the tracker's error, which is taken
out before."""
DRIFT_RAD = float(np.deg2rad(5.0))
"""Angle of that tube [rad]."""
_DRIFT_FRAMES = 5
"""Frames of the running median before this comparison."""
_MIN_DRIFT = 3
"""Least number of frames after the onset."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSeries:
    """Poses of the gripper and gaps between its pads over time, in one frame."""

    t_s: Array
    """(T,) times, increasing [s]."""
    X: Array
    """(T, 4, 4) poses of the TCP [m]; NaN where unknown."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]; NaN where unknown."""
    sigma_m: float = 0.0
    """Standard deviation of the positions, root of the sum over the axes [m]."""
    sigma_rad: float = 0.0
    """Standard deviation of the rotations, likewise [rad]."""
    offset_m: float = 0.0
    """Greatest position error that all poses may share [m]."""
    offset_rad: float = 0.0
    """Greatest rotation error that they may share [rad]."""

    def __post_init__(self) -> None:
        """Check shapes against the number of frames.

        Raises:
            InputError: a shape is wrong.
        """
        n = len(self.t_s)
        if self.X.shape != (n, 4, 4) or self.finger_width_m.shape != (n,):
            raise InputError(f"{n} times, but poses {self.X.shape} and gaps {self.finger_width_m.shape}")

    @classmethod
    def of_track(cls, track: GripperTrack, X: Array | None = None) -> "PoseSeries":
        """Return the tracked poses of a track, with the errors that it shows.

        Args:
            X: (T, 4, 4) poses [m] in place of those in the base frame.
        """
        X = track.X_BG if X is None else X
        valid = track.tracked & finite_rows(X.reshape(-1, 16))
        noise = estimate_track_noise(track.t_s, X, valid)
        return cls(
            t_s=track.t_s,
            X=np.where(valid[:, None, None], X, np.nan),
            finger_width_m=np.where(valid, track.finger_width_m, np.nan),
            sigma_m=float(np.sqrt(3.0) * np.nan_to_num(noise.position_m)),
            sigma_rad=float(np.sqrt(3.0) * np.nan_to_num(noise.rotation_rad)),
            offset_m=track.offset_m,
            offset_rad=track.offset_rad,
        )

    @property
    def period_s(self) -> float:
        """Time between two frames [s]."""
        return float(np.median(np.diff(self.t_s)))

    def at(self, t_s: Array) -> "PoseSeries":
        """Interpolate two or more poses at times (N,) [s]: the first and the last outside, NaN beside unknown ones."""
        places = np.interp(t_s, self.t_s, np.arange(len(self.t_s)))
        before = np.minimum(places.astype(np.intp), len(self.t_s) - 2)
        s = places - before
        finite = finite_rows(self.X.reshape(-1, 16))
        valid = (finite[before] | (s == 1.0)) & (finite[before + 1] | (s == 0.0))
        first = np.where(finite[before], before, before + 1)[valid]
        second = np.where(finite[before + 1], before + 1, before)[valid]
        X = spread(interpolate_pose(self.X[first], self.X[second], s[valid]), valid, len(t_s))
        return replace(self, t_s=t_s, X=X, finger_width_m=np.interp(t_s, self.t_s, self.finger_width_m))

    def repeated(self, again: "PoseSeries") -> "PoseSeries":
        """Return the poses with no less error than their root mean square difference from a second measurement."""
        distance, angle = (values[np.isfinite(values)] for values in pose_difference(self.X, again.X))
        if not len(distance):
            return self
        sigma_m = max(self.sigma_m, float(np.sqrt(np.mean(distance**2))))
        return replace(self, sigma_m=sigma_m, sigma_rad=max(self.sigma_rad, float(np.sqrt(np.mean(angle**2)))))

    def taken(self, rows: NDArray[np.intp]) -> "PoseSeries":
        """Return the frames `rows` (N,) in this order."""
        return replace(self, t_s=self.t_s[rows], X=self.X[rows], finger_width_m=self.finger_width_m[rows])


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviation:
    """Differences between measured and commanded poses, frame by frame; NaN where either is unknown."""

    distance_m: Array
    """(N,) distance of the TCP [m]."""
    angle_rad: Array
    """(N,) rotation between the two [rad]."""
    finger_m: Array
    """(N,) difference of the gaps between the finger pads [m]."""
    distance_px: Array
    """(N,) distance of the TCP in the image [px]; NaN without a camera."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Following:
    """How far a clip follows its commands."""

    follows: bool | None
    """Whether it does; None: undecided."""
    reason: str
    """What the verdict rests on, or why there is none."""
    share: float
    """Share of the frames inside the tube; lost frames count as outside."""
    lag_frames: float | None
    """Delay of the motion [frames]; None where all lags fit alike, or the best one lies outside `LAGS`."""
    gain: float | None
    """Motion made over motion commanded; None where nearly none is commanded."""
    deviation: Deviation
    """Deviation at the lag (at none where that is None), the tracker's error taken out."""
    drift_from_frame: int | None
    """Frame from which on it stays outside the tube of the drift; None if it does not."""
    drift_m: float | None
    """Median deviation from there on [m]."""
    controls: Mapping[str, float]
    """Share of the frames inside the tube about the commands of each control."""

    def median(self, name: str) -> float | None:
        """Return the median of a deviation by its name, lost frames worse than any; None where it is lost."""
        return worst_median(getattr(self.deviation, name))


def worst_median(values: Array) -> float | None:
    """Return the median of values (N,), NaN worse than any; None where half or more are NaN."""
    value = float(np.median(np.where(np.isnan(values), np.inf, values))) if len(values) else np.inf
    return value if np.isfinite(value) else None


def deviate(measured: PoseSeries, commanded: PoseSeries, camera: Camera | None = None) -> Deviation:
    """Return the deviation of poses from commands row by row, the tracker's error taken out of distances and angles.

    Args:
        measured: poses of N frames.
        commanded: their commands.
        camera: camera of the frames, where the poses are in the robot base frame.
    """
    distance, angle = pose_difference(measured.X, commanded.X)
    sigma_m = np.hypot(measured.sigma_m, commanded.sigma_m)
    sigma_rad = np.hypot(measured.sigma_rad, commanded.sigma_rad)
    distance_px = np.full(len(distance), np.nan)
    if camera is not None:
        p_C = [transform_points(invert(camera.X_BC), X[:, :3, 3]) for X in (measured.X, commanded.X)]
        across = np.sqrt(2.0 / 3.0) * sigma_m * camera.fx / p_C[0][:, 2]  # of the three axes two are seen
        apart = np.linalg.norm(camera.project(p_C[0]) - camera.project(p_C[1]), axis=-1)
        distance_px = _without(apart, across)
    return Deviation(
        distance_m=_without(distance, sigma_m),
        angle_rad=_without(angle, sigma_rad),
        finger_m=np.abs(measured.finger_width_m - commanded.finger_width_m),
        distance_px=distance_px,
    )


def _without(deviation: Array, sigma: float | Array) -> Array:
    """Take an error out of deviations (N,): square less square, 0 at least."""
    return np.asarray(np.sqrt(np.maximum(deviation**2 - np.square(sigma), 0.0)))


def measure_following(
    measured: PoseSeries,
    commanded: PoseSeries,
    rng: np.random.Generator,
    *,
    other: PoseSeries | None = None,
    camera: Camera | None = None,
) -> Following:
    """Compare the measured motion of a clip with the commanded one.

    The part of the clip after the last command is not compared. With the controls the same is done: commands in random
    order or those of another clip, reversed ones, and the first one throughout.

    Args:
        measured: poses of the frames; NaN where lost.
        commanded: commands in the same frame, on the same clock.
        rng: determines the order of the shuffled commands.
        other: commands of another clip, in place of shuffled ones unless they are the same motion.
        camera: camera of the frames, where the poses are in the robot base frame.

    Raises:
        InputError: there are fewer than two commands, or fewer than two frames before the last one.
    """
    own = np.flatnonzero(measured.t_s <= commanded.t_s[-1] + 0.5 * measured.period_s)
    if min(len(own), len(commanded.t_s)) < 2:
        raise InputError(f"{len(commanded.t_s)} commands and {len(own)} frames up to the last, expected two or more")
    frames = measured.taken(own)
    commands = commanded.at(frames.t_s)
    rows = np.arange(len(own))
    if other is not None and _Match.of(commands, other).share >= FOLLOWING_SHARE:
        other = None  # the same motion is no control
    controls = {
        "shuffled": commands.taken(rng.permutation(rows)) if other is None else other.at(frames.t_s),
        "reversed": commands.taken(rows[::-1]),
        "still": commands.taken(np.zeros_like(rows)),
    }
    controls = {name: replace(control, t_s=frames.t_s) for name, control in controls.items()}
    match = _Match.of(frames, commanded)
    rivals = {name: _Match.of(frames, control) for name, control in controls.items()}
    follows, reason = _decide(match, rivals)
    lag_frames, gain = _fit(frames, match)
    deviation = deviate(frames, match.commanded(lag_frames or 0.0), camera)
    onset = _find_drift(deviation)
    drift_m = None if onset is None else float(np.nanmedian(deviation.distance_m[onset:]))
    return Following(
        follows=follows,
        reason=reason,
        share=match.share,
        lag_frames=lag_frames,
        gain=gain,
        deviation=deviation,
        drift_from_frame=onset,
        drift_m=drift_m,
        controls={name: rival.share for name, rival in rivals.items()},
    )


def find_lag(measured: PoseSeries, commanded: PoseSeries) -> float | None:
    """Return the delay of a measured motion behind its commands [frames]; None as in `Following.lag_frames`."""
    return _fit(measured, _Match.of(measured, commanded))[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Match:
    """Frames beside commands at every lag."""

    lags: Array
    """(L,) delays of the commands [frames]."""
    delayed: PoseSeries
    """Commands at every lag, L times those of T frames."""
    excess: Array
    """(L, T) deviation [tubes]; NaN where lost."""

    @classmethod
    def of(cls, frames: PoseSeries, commanded: PoseSeries) -> "_Match":
        """Compare frames with delayed commands; lags reach half a frame beyond `LAGS`, to see where these end."""
        lags = np.arange(LAGS[0] - 0.5, LAGS[1] + 0.5 + 0.5 * _LAG_STEP, _LAG_STEP).round(6)
        delayed = commanded.at((frames.t_s - frames.period_s * lags[:, None]).ravel())
        distance, angle = pose_difference(frames.X, delayed.X.reshape(len(lags), -1, 4, 4))
        # no narrower than what poses may be off together, as with an estimated camera
        tube_m = max(TUBE_M, frames.offset_m) + TUBE_SIGMAS * np.hypot(frames.sigma_m, commanded.sigma_m)
        tube_rad = max(TUBE_RAD, frames.offset_rad) + TUBE_SIGMAS * np.hypot(frames.sigma_rad, commanded.sigma_rad)
        return cls(lags=lags, delayed=delayed, excess=np.maximum(distance / tube_m, angle / tube_rad))

    @property
    def share(self) -> float:
        """Greatest share of the frames inside the tube over the lags; lost frames count as outside."""
        return float((self.excess <= 1.0).mean(axis=1).max())

    @property
    def far_share(self) -> float:
        """Least share of the frames clearly outside over the lags; lost frames do not count as such."""
        return float((self.excess > FAR).mean(axis=1).min())

    def cost(self, lost: float) -> float:
        """Return the least mean deviation over the lags [tubes], that of lost frames `lost`."""
        return float(np.minimum(np.where(np.isnan(self.excess), lost, self.excess), _CAP).mean(axis=1).min())

    def commanded(self, lag_frames: float) -> PoseSeries:
        """Return the commands at one of the lags."""
        k = int(np.argmin(np.abs(self.lags - lag_frames)))
        return self.delayed.taken(np.arange(self.delayed.t_s.size).reshape(self.excess.shape)[k])


def _decide(match: _Match, rivals: Mapping[str, _Match]) -> tuple[bool | None, str]:
    """Return the verdict with its reason; no frame that is lost can make it true."""
    n = match.excess.shape[1]
    inside = f"{round(match.share * n)} of {n} frames within {100 * TUBE_M:g} cm and {np.rad2deg(TUBE_RAD):.0f} degrees"
    if n < MIN_FRAMES:
        return None, f"{n} frames to compare, at least {MIN_FRAMES} are needed"
    if match.share >= FOLLOWING_SHARE:
        cost = match.cost(lost=_CAP)
        alike = [name for name, rival in rivals.items() if cost > CONTROL_RATIO * rival.cost(lost=0.0)]
        if not alike:
            return True, inside
        return None, f"{inside}, but {' and '.join(alike)} actions fit nearly as well, which is no evidence"
    if match.far_share >= FAR_SHARE:
        return False, f"{inside}, {round(match.far_share * n)} beyond {FAR:g} times that at every lag"
    lost = int(np.isnan(match.excess).all(axis=0).sum())
    unknown = f"{lost} not measured, " if lost else ""
    return None, f"{inside}, {unknown}{round(match.far_share * n)} clearly outside"


def _fit(frames: PoseSeries, match: _Match) -> tuple[float | None, float | None]:
    """Return the lag [frames] or None, and the gain at it or None."""
    commanded = _point_path(match.delayed.X).reshape(len(match.lags), -1, 9)
    measured = _point_path(frames.X)
    valid = finite_rows(measured) & finite_rows(commanded)
    m = np.where(valid[..., None], measured, 0.0)
    c = np.where(valid[..., None], commanded, 0.0)
    count = np.maximum(valid.sum(axis=1), 1)
    weight = valid / count[:, None]
    for _ in range(_FITS):
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        m_from_mean = m - np.einsum("lt,ltd->ld", weight, m)[:, None]
        c_from_mean = c - np.einsum("lt,ltd->ld", weight, c)[:, None]
        power = np.einsum("lt,ltd->l", weight, c_from_mean**2)
        gain = np.einsum("lt,ltd->l", weight, m_from_mean * c_from_mean) / np.maximum(power, 1e-12)
        residual = np.linalg.norm(m_from_mean - gain[:, None, None] * c_from_mean, axis=-1) / np.sqrt(3.0)
        weight = valid * _HUBER_M / np.maximum(residual, _HUBER_M)
    huber = np.where(residual < _HUBER_M, 0.5 * residual**2, _HUBER_M * (residual - 0.5 * _HUBER_M))
    loss = (valid * huber).sum(axis=1) / count
    best = int(np.argmin(loss))
    elsewhere = loss[np.abs(match.lags - match.lags[best]) >= 1.0]
    lead = float(1.0 - loss[best] / max(elsewhere.min(), 1e-12))
    is_clear = lead >= LEAD and LAGS[0] <= match.lags[best] <= LAGS[1]
    is_clear &= gain[best] >= MIN_GAIN and count[best] >= MIN_FRAMES
    chosen = best if is_clear else int(np.argmin(np.abs(match.lags)))
    moved = float(np.sqrt(power[chosen] / 3.0))
    return float(match.lags[best]) if is_clear else None, float(gain[chosen]) if moved >= MIN_MOTION_M else None


def _point_path(X: Array) -> Array:
    """Return the path (T, 9) [m] of three points that move with poses (T, 4, 4)."""
    p = X[:, :3, 3]
    return np.concatenate([p, p + _LEVER_M * X[:, :3, 0], p + _LEVER_M * X[:, :3, 1]], axis=1)


def _find_drift(deviation: Deviation) -> int | None:
    """Return the first frame after which the running median of the deviation stays outside the tube of the drift."""
    measured = np.flatnonzero(np.isfinite(deviation.distance_m))
    if len(measured) < _MIN_DRIFT:
        return None
    distance = median_filter(deviation.distance_m[measured], _DRIFT_FRAMES, mode="nearest")
    angle = median_filter(deviation.angle_rad[measured], _DRIFT_FRAMES, mode="nearest")
    first = find_onset((distance <= DRIFT_M) & (angle <= DRIFT_RAD))
    return None if first is None else int(measured[first])


def find_onset(inside: NDArray[np.bool_]) -> int | None:
    """Return the first frame from which on none of three or more frames lies `inside` (N,) a tube, or None."""
    inside_frames = np.flatnonzero(inside)
    first = int(inside_frames[-1]) + 1 if len(inside_frames) else 0
    return first if first <= len(inside) - _MIN_DRIFT else None
