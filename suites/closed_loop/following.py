"""Action-conditioned world models: the expert's track as actions, and the error with which a video follows them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.metrics.following import MIN_FRAMES, Deviation, PoseSeries, deviate, find_lag, worst_median
from kinebench_drake.suites.clock import FRAME_PERIOD_S, Control
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import continue_expert
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.simulator import Simulator, SimulatorState
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack
from kinebench_drake.track import GripperTrack

_FIELDS = {"m": "distance_m", "rad": "angle_rad", "finger_m": "finger_m"}
"""Fields of `Deviation` by the end of their metrics' names."""
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
class ActionFollowing:
    """Deviations of one clip after its first frame, which was given; commanded frames that it lacks are lost."""

    commanded: Deviation
    """From the commanded track."""
    shuffled: Deviation
    """From the commanded frames in random order: the error of a video that does not depend on them."""
    lag_frames: float | None
    """Delay of the clip [frames]; None where it is not clear."""


def measure_following(track: GripperTrack, actions: ActionTrack, *seed: str | int) -> ActionFollowing:
    """Compare the grounded track of a clip with the actions that were requested (`metrics.following`).

    The actions are interpolated at the times of the clip's frames. Commanded frames after the end of a shorter clip are
    lost; the part of a longer clip after the last action is not compared.

    Args:
        *seed: words that determine the order of the shuffled actions.
    """
    period_s = float(actions.t_s[1] - actions.t_s[0])
    own = np.flatnonzero((np.arange(len(track.t_s)) > 0) & (track.t_s <= actions.t_s[-1] + 0.5 * period_s))
    absent = int((actions.t_s > track.t_s[-1] + 0.5 * period_s).sum())
    frames = track.at(own)
    X_BG = np.where(frames.tracked[:, None, None], frames.X_BG, np.nan)
    measured = PoseSeries(t_s=frames.t_s, X=X_BG, finger_width_m=frames.finger_width_m)
    commanded = PoseSeries(t_s=actions.t_s, X=actions.X_BG, finger_width_m=actions.finger_width_m)
    order = generator("shuffled actions", *seed).permutation(len(own))
    return ActionFollowing(
        commanded=_extended(deviate(measured, commanded.at(frames.t_s)), np.nan, absent),
        # where nothing is seen, chance does as well as can be
        shuffled=_extended(deviate(measured, commanded.at(frames.t_s[order])), 0.0, absent),
        lag_frames=find_lag(measured, commanded) if len(own) >= MIN_FRAMES else None,
    )


def _extended(deviation: Deviation, lost: float, absent: int) -> Deviation:
    """Return a deviation that is `lost` where it is unknown, and in as many frames more as are `absent`."""
    arrays = {f.name: getattr(deviation, f.name) for f in fields(deviation)}
    return Deviation(**{k: np.append(np.nan_to_num(v, nan=lost), np.full(absent, lost)) for k, v in arrays.items()})


def summarize_following(clips: Sequence[ActionFollowing], period_s: float) -> dict[str, float | None]:
    """Return the metrics of an episode: medians over the frames of all clips, a lost frame worse than any other.

    `action_following` is 1 - error / shuffled error of the position: 1 if the video does what was commanded, 0 if it
    does not depend on it. `action_lag_s` is the median delay of the clips, if `action_following` exceeds 0.5.
    A median over frames of which half are lost is None.
    """
    of = {"error": [clip.commanded for clip in clips], "shuffled": [clip.shuffled for clip in clips]}
    medians = {
        f"action_{kind}_{suffix}": worst_median(np.concatenate([getattr(error, name) for error in errors]))
        for kind, errors in of.items()
        for suffix, name in _FIELDS.items()
    }
    lags = [clip.lag_frames for clip in clips if clip.lag_frames is not None]
    error = medians["action_error_m"]
    chance = medians["action_shuffled_m"]
    follows = error is not None and chance is not None and error < 0.5 * chance
    return {
        **medians,
        "action_following": None if error is None or not chance else 1.0 - error / chance,
        "action_lag_s": period_s * float(np.median(lags)) if follows and lags else None,
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
