"""Action-conditioned world models: the expert's track as actions, and the error with which a video follows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from kinebench_drake.geometry import Array, interpolate_pose, pose_difference
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.clock import FRAME_PERIOD_S, Control
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import continue_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, SimulatorState
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack
from kinebench_drake.track import GripperTrack

_LAGS = 11
"""Delays that are tried, from 0 on [frames]."""
_FIELDS = {"m": "distance_m", "rad": "angle_rad", "finger_m": "finger_m"}
"""Fields of `ActionError` by the end of their metrics' names."""
ACTION_METRICS = (
    *(f"action_{kind}_{suffix}" for kind in ("error", "shuffled") for suffix in _FIELDS),
    "action_following",
    "action_lag_s",
)
"""Metrics of an episode whose clips were conditioned on actions."""


class ActionSource:
    """Expert that continues an episode in a simulator of its own, without rendering.

    Args:
        size_px: side of the camera's images, which are not rendered [px].
    """

    def __init__(self, plant: ArmPlant, size_px: int) -> None:
        self._plant = plant
        self._simulators = SimulatorCache(partial(Simulator, control=Control.JOINTS), size_px, renders=False)

    def track(self, episode: Episode, state: SimulatorState, frames: int, period_s: float) -> ActionTrack:
        """Return the states that the robot reaches if the expert continues from a state, which the first frame shows.

        Args:
            frames: number of frames; after the expert's clip of 9.6 s it waits.
            period_s: task time between two frames [s].
        """
        simulator = self._simulators.get(episode.task, episode.variant)
        snapshots = continue_expert(simulator, episode, state, find_expert(episode.task)).snapshots
        reached_s = FRAME_PERIOD_S * np.arange(len(snapshots), dtype=np.float64)
        t_s = period_s * np.arange(frames, dtype=np.float64)
        reached = np.array([[*s.q, s.finger_width_m] for s in snapshots])
        values = np.column_stack([np.interp(t_s, reached_s, column) for column in reached.T])
        q = values[:, :7]
        return ActionTrack(t_s=t_s, X_BG=self._plant.forward_path(q), finger_width_m=values[:, 7], q=q)

    def close(self) -> None:
        """Release the simulator."""
        self._simulators.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionError:
    """Differences between a grounded track and commanded actions, frame by frame; infinite where a frame is lost."""

    distance_m: Array
    """(N,) distance of panda_hand_tcp [m]."""
    angle_rad: Array
    """(N,) rotation between the two [rad]."""
    finger_m: Array
    """(N,) difference of the gaps between the finger pads [m]; infinite where the gap is unknown, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionFollowing:
    """Errors of one clip after its first frame, which was given."""

    commanded: ActionError
    """Against the commanded track."""
    shuffled: ActionError
    """Against the commanded frames in random order: the error of a video that does not depend on them."""
    lagged: tuple[ActionError, ...]
    """Against the commanded track delayed by 0, 1, ... frames."""


def measure_following(track: GripperTrack, actions: ActionTrack, *seed: str | int) -> ActionFollowing:
    """Compare the grounded track of a clip with the actions that were requested.

    The actions are interpolated at the times of the clip's frames. Commanded frames after the end of a shorter clip are
    lost; the part of a longer clip after the last action is not compared.

    Args:
        *seed: words that determine the order of the shuffled actions.
    """
    period_s = float(actions.t_s[1] - actions.t_s[0])
    own = np.flatnonzero((np.arange(len(track.t_s)) > 0) & (track.t_s <= actions.t_s[-1] + 0.5 * period_s))
    absent = int((actions.t_s > track.t_s[-1] + 0.5 * period_s).sum())
    frames = track.at(own)
    order = generator("shuffled actions", *seed).permutation(len(own))

    def compare(at: Array, lost: float = np.inf) -> ActionError:
        X_BG, finger_width_m = _interpolate(actions, at)
        distance, angle = pose_difference(frames.X_BG, X_BG)
        finger = np.abs(frames.finger_width_m - finger_width_m)
        after = np.full(absent, lost)
        return ActionError(
            **{
                name: np.concatenate([np.where(frames.tracked & np.isfinite(error), error, lost), after])
                for name, error in (("distance_m", distance), ("angle_rad", angle), ("finger_m", finger))
            }
        )

    return ActionFollowing(
        commanded=compare(frames.t_s),
        shuffled=compare(frames.t_s[order], lost=0.0),  # where nothing is seen, chance does as well as can be
        lagged=tuple(compare(frames.t_s - lag * period_s) for lag in range(_LAGS)),
    )


def _interpolate(actions: ActionTrack, t_s: Array) -> tuple[Array, Array]:
    """Return poses (N, 4, 4) and gaps (N,) at times (N,), those of the first and last action outside."""
    places = np.interp(t_s, actions.t_s, np.arange(len(actions.t_s)))
    before = np.minimum(places.astype(np.intp), len(actions.t_s) - 2)
    poses = [
        interpolate_pose(actions.X_BG[k], actions.X_BG[k + 1], s) for k, s in zip(before, places - before, strict=True)
    ]
    return np.reshape(poses, (-1, 4, 4)), np.interp(t_s, actions.t_s, actions.finger_width_m)


def summarize_following(clips: Sequence[ActionFollowing], period_s: float) -> dict[str, float | None]:
    """Return the metrics of an episode: medians over the frames of all clips, a lost frame worse than any other.

    `action_following` is 1 - error / shuffled error of the position: 1 if the video does what was commanded, 0 if it
    does not depend on it. `action_lag_s` is the delay with the least error, if `action_following` exceeds 0.5.
    A median over frames of which half are lost is None.
    """
    of = {"error": [clip.commanded for clip in clips], "shuffled": [clip.shuffled for clip in clips]}
    medians = {
        f"action_{kind}_{suffix}": _median([getattr(error, name) for error in errors])
        for kind, errors in of.items()
        for suffix, name in _FIELDS.items()
    }
    lags = [_median([clip.lagged[k].distance_m for clip in clips]) for k in range(_LAGS)]
    error = medians["action_error_m"]
    chance = medians["action_shuffled_m"]
    best = min((lag for lag in lags if lag is not None), default=None)
    follows = best is not None and error is not None and chance is not None and error < 0.5 * chance
    return {
        **medians,
        "action_following": None if error is None or not chance else 1.0 - error / chance,
        "action_lag_s": period_s * lags.index(best) if follows else None,
    }


def action_curves(tracks: Sequence[GripperTrack], actions: Sequence[ActionTrack | None]) -> dict[str, Array]:
    """Return the commanded joint angles (T, 7) [rad] and gaps (T,) [m] at the frames of the joined tracks."""
    curves = dict[str, list[Array]](commanded_q=[], commanded_finger_width_m=[])
    for number, (track, own) in enumerate(zip(tracks, actions, strict=True)):
        if own is None:
            return {}
        t_s = track.t_s[number > 0 :] - track.t_s[0]
        curves["commanded_q"].append(np.column_stack([np.interp(t_s, own.t_s, column) for column in own.q.T]))
        curves["commanded_finger_width_m"].append(np.interp(t_s, own.t_s, own.finger_width_m))
    return {name: np.concatenate(parts) for name, parts in curves.items()}


def _median(clips: Sequence[Array]) -> float | None:
    """Return the median of the errors of all clips, None where it is infinite."""
    errors = np.concatenate(clips)
    value = float(np.median(errors)) if len(errors) else np.inf
    return value if np.isfinite(value) else None
