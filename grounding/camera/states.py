"""Known states of the robot in the frames of a video: postures from a file, or one posture in one frame."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.formats.trajectories.reading import JOINTS, Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import Trajectory, TrajectorySample
from kinebench_drake.geometry import Array, interpolate_pose, invert
from kinebench_drake.grounding.registration.arm_model import ArmModel
from kinebench_drake.models.panda.description import GRIPPER, RobotPart, hand_from_tcp, rest_q
from kinebench_drake.models.robot import N_JOINTS
from kinebench_drake.segments import spread

POSTURES = {"home": np.pi * np.array([0.0, -1 / 4, 0.0, -3 / 4, 0.0, 1 / 2, 1 / 4]), "rest": rest_q()}
"""Named postures (7,) [rad]: the start posture of Franka's programs (libfranka, franka_ros), and that of ManiSkill."""
_MAX_RAD = 4.0
"""Largest joint angle [rad]: larger numbers are degrees."""
_LATE_S = 0.1
"""Greatest time by which frames may lie outside the joint angles [s]."""
_MAX_GAP_S = 0.5
"""Greatest time between joint angles that are interpolated [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotStates:
    """States of the robot in T frames; NaN where unknown."""

    q: Array
    """(T, 7) joint angles [rad]."""
    X_BH: Array
    """(T, 4, 4) pose of panda_hand in B [m]; finite where `q` or the pose of the TCP is known."""
    finger_m: Array
    """(T,) opening of each finger [m]."""
    source: str
    """Source of the states."""

    @property
    def has_hand(self) -> NDArray[np.bool_]:
        """(T,) frames of known hand pose."""
        return np.asarray(np.isfinite(self.X_BH).all(axis=(1, 2)))

    @property
    def has_posture(self) -> NDArray[np.bool_]:
        """(T,) frames of known joint angles."""
        return np.asarray(np.isfinite(self.q).all(axis=1))

    def take(self, frames: NDArray[np.intp]) -> "RobotStates":
        """Select frames."""
        return replace(self, q=self.q[frames], X_BH=self.X_BH[frames], finger_m=self.finger_m[frames])

    def only(self, frames: NDArray[np.intp]) -> "RobotStates":
        """Return the states of some frames; those of all others become unknown."""
        count = len(self.q)
        q = spread(self.q[frames], frames, count)
        X_BH = spread(self.X_BH[frames], frames, count)
        return replace(self, q=q, X_BH=X_BH, finger_m=spread(self.finger_m[frames], frames, count))

    def q_at_lag(self, frames: float) -> Array:
        """Return the joint angles (T, 7) of rows that come `frames` later, interpolated; NaN where there are none."""
        rows = np.arange(len(self.q), dtype=np.float64)
        joints = [np.interp(rows + frames, rows, angles, left=np.nan, right=np.nan) for angles in self.q.T]
        return np.stack(joints, axis=1)

    def part_poses(self, model: ArmModel) -> Array:
        """Return the frames (T, PARTS, 4, 4) of the parts' CAD coordinates in B [m]; NaN where unknown."""
        finite = self.has_posture
        X = model.poses(np.where(finite[:, None], self.q, 0.0))
        X[~finite] = np.nan
        X[:, RobotPart.LINK0] = np.eye(4)
        X[:, list(GRIPPER)] = np.where(finite[:, None, None, None], X[:, list(GRIPPER)], self.X_BH[:, None])
        return np.asarray(X)


def make_posture_states(text: str, frame: int, frames: int, model: ArmModel) -> RobotStates:
    """Return states with one posture in one frame.

    Args:
        text: a name of `POSTURES`, or seven joint angles [rad] separated by commas.
        frame: number of the frame.
        frames: number of frames of the video.
        model: link poses of the arm.

    Raises:
        UsageError: the text is neither, or there is no such frame.
    """
    q = parse_posture(text)
    if q is None:
        raise UsageError(
            f"$joints {text}: there is no such file; expected a file of joint angles, {N_JOINTS} angles in radians "
            f"separated by commas, or one of {', '.join(POSTURES)}"
        )
    if not 0 <= frame < frames:
        raise UsageError(f"$joints_frame is {frame}, expected 0 to {frames - 1}: the video has {frames} frames")
    return _of_joints(
        spread(q[None], np.array([frame]), frames), np.full(frames, np.nan), f"posture {text} in frame {frame}", model
    )


def parse_posture(text: str) -> Array | None:
    """Parse a posture (7,) [rad] by name or as a list of angles; None if the text is neither.

    Raises:
        UsageError: the text lists numbers that are no posture.
    """
    if text in POSTURES:
        return POSTURES[text]
    try:
        q = np.array([float(field) for field in text.split(",")])
    except ValueError:
        return None
    if len(q) != N_JOINTS or not np.isfinite(q).all() or np.abs(q).max() > _MAX_RAD:
        raise UsageError(
            f"$joints {text}: expected {N_JOINTS} joint angles in radians, each within {_MAX_RAD:g}, found {len(q)} "
            f"numbers, the largest {np.abs(q).max():g}"
        )
    return q


def read_states(path: Path, episode: str | None, column: str | None, t_s: Array, model: ArmModel) -> RobotStates:
    """Read the states of the robot in each frame from a file of joint angles or TCP poses.

    The rows of a file with as many rows as frames are the states of the frames; other files are interpolated at the
    times of the frames, both clocks starting at 0.

    Args:
        path: a file as for `audit`: npz, csv, ManiSkill h5, or a LeRobot dataset.
        episode: name of the episode, if there are several.
        column: name of the array or column of joint angles, if ambiguous.
        t_s: (T,) times of the frames of the video [s]; NaN where unknown.
        model: link poses of the arm.

    Raises:
        UsageError: there is no such file or episode, or several and none is named, or the times of the frames are
            needed.
        InputError: the file is invalid, or inconsistent with the video.
    """
    reading = None if column is None else Reading(columns=(column,), layout=JOINTS)
    sample = _episode(find_trajectories(path, TrajectoryOptions(reading=reading)), path, episode)
    by_rows = _read(sample, TrajectoryOptions(reading=reading, rate_hz=1.0))
    if len(by_rows.t_s) != len(t_s):
        if np.isnan(t_s).any():
            raise UsageError(
                f"$joints {path.name}: {len(by_rows.t_s)} rows, but {len(t_s)} frames of a video without a clock; "
                "give $frame_period_s SECONDS, or a row a frame"
            )
        by_rows = _at(_read(sample, TrajectoryOptions(reading=reading)), t_s, path.name)
    fingers = by_rows.finger_width_m / 2
    source = f"{path.name}, {by_rows.columns}"
    if by_rows.q is not None:
        return _of_joints(by_rows.q, fingers, source, model)
    X_BH = (by_rows.X_BG if by_rows.X_BG is not None else np.empty((0, 4, 4))) @ invert(hand_from_tcp())
    return RobotStates(q=np.full((len(X_BH), N_JOINTS), np.nan), X_BH=X_BH, finger_m=fingers, source=source)


def _of_joints(q: Array, finger_m: Array, source: str, model: ArmModel) -> RobotStates:
    finite = np.asarray(np.isfinite(q).all(axis=1))
    X_BH = model.poses(np.where(finite[:, None], q, 0.0))[:, RobotPart.HAND]
    X_BH[~finite] = np.nan
    return RobotStates(q=q, X_BH=X_BH, finger_m=finger_m, source=source)


def _read(sample: TrajectorySample, choice: TrajectoryOptions) -> Trajectory:
    try:
        return read_trajectory(sample, choice)
    except InputError as error:
        raise InputError(f"$joints {sample.video}: {error}") from None


def _episode(samples: tuple[TrajectorySample, ...], path: Path, episode: str | None) -> TrajectorySample:
    names = [sample.part or sample.id for sample in samples]
    chosen = [
        sample
        for sample, name in zip(samples, names, strict=True)
        if episode in (None, name, name.removeprefix("traj_"))
    ]
    if len(chosen) != 1:
        content = f"no episode {episode}" if not chosen else f"{len(chosen)} episodes"
        few = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        raise UsageError(f"$joints {path}: contains {content}; name that of the video with $episode, one of {few}")
    return chosen[0]


def _at(trajectory: Trajectory, t_s: Array, name: str) -> Trajectory:
    """Interpolate a trajectory at the times of the frames [s]; NaN within gaps and next to unknown rows.

    Raises:
        InputError: the video extends beyond the trajectory.
    """
    own = trajectory.t_s - trajectory.t_s[0]
    if t_s[-1] > own[-1] + _LATE_S:
        raise InputError(
            f"$joints {name}: {len(own)} rows over {own[-1]:.2f} s, but the video has {len(t_s)} frames over "
            f"{t_s[-1]:.2f} s; expected one row per frame, or times t_s that cover the video ($frame_period_s SECONDS "
            "sets those of the video)"
        )
    after = np.clip(np.searchsorted(own, t_s), 1, len(own) - 1)
    step = own[after] - own[after - 1]
    s = np.clip((t_s - own[after - 1]) / step, 0.0, 1.0)
    near = step <= _MAX_GAP_S

    def interpolate(values: Array) -> Array:
        return np.where(near[:, None], (1.0 - s)[:, None] * values[after - 1] + s[:, None] * values[after], np.nan)

    q = trajectory.q
    X_BG = trajectory.X_BG
    if X_BG is not None:
        X_BG = np.stack(
            [
                interpolate_pose(X_BG[k - 1], X_BG[k], float(part))
                if ok and trajectory.tracked[[k - 1, k]].all()
                else np.full((4, 4), np.nan)
                for k, part, ok in zip(after, s, near, strict=True)
            ]
        )
    return replace(
        trajectory,
        t_s=t_s,
        q=None if q is None else interpolate(q),
        X_BG=X_BG,
        tracked=near & trajectory.tracked[after - 1] & trajectory.tracked[after],
        finger_width_m=interpolate(trajectory.finger_width_m[:, None])[:, 0],
    )
