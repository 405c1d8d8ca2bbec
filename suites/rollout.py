"""Rollouts of experts in the simulator, and their rendering, which is separate from the physics."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.camera import Camera
from kinebench_drake.geometry import Array, invert
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.panda.description import HAND_LINK, TCP_LINK
from kinebench_drake.suites.clock import CLIP_FRAMES, FRAME_PERIOD_S, STEPS_PER_FRAME
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.expert.motion import plan
from kinebench_drake.suites.families.registry import Expert
from kinebench_drake.suites.simulator import CameraImage, Simulator, SimulatorState, Snapshot, TaskOutcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollout:
    """Rollout of one episode."""

    episode: Episode
    snapshots: tuple[Snapshot, ...]
    """(T,) states at constant intervals, `FRAME_PERIOD_S` by default."""
    controls: Array
    """(N, 8) commands at 20 Hz: seven joint angles [rad] and the gap between the finger pads [m]."""
    outcome: TaskOutcome
    """Outcome of the last state."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloutVideo:
    """Rendered rollout with ground truth."""

    camera: Camera
    rgb: NDArray[np.uint8]
    """(T, H, W, 3) frames."""
    t_s: Array
    """(T,) task time [s]."""
    q: Array
    """(T, 7) arm joint angles [rad]; NaN where the gripper is not drawn, as in the poses."""
    finger_width_m: Array
    """(T,) gap between the finger pads [m]."""
    X_CH: Array
    """(T, 4, 4) panda_hand in the camera frame [m]."""
    X_BG: Array
    """(T, 4, 4) panda_hand_tcp in the robot base frame [m]."""
    depth_mm: NDArray[np.uint16]
    """(T, H, W) distance along the camera's z, truncated to millimetres; 0 for no surface."""
    mask: NDArray[np.bool_]
    """(T, H, W) pixels of the gripper (hand and fingers)."""
    robot: NDArray[np.bool_]
    """(T, H, W) pixels of the robot, including the gripper."""

    def select(self, frames: slice | Sequence[int]) -> "RolloutVideo":
        """Return the video of these frames."""
        arrays = (field.name for field in fields(self) if field.name != "camera")
        return replace(self, **{name: getattr(self, name)[frames] for name in arrays})


def _run_clip(
    simulator: Simulator, expert: Expert, every: int = STEPS_PER_FRAME
) -> tuple[tuple[Snapshot, ...], Array] | None:
    """Let the expert continue its task for one clip; None if nothing is left to do.

    Returns:
        The states without the initial one, and the commands (N, 8) as in `Rollout`.
    """
    scene = simulator.scene()
    now = simulator.snapshot()
    waypoints = expert(scene)
    if not waypoints:
        return None
    motion = plan(ArmPlant(), now.q, now.finger_width_m, waypoints, STEPS_PER_FRAME * CLIP_FRAMES, scene)
    snapshots = []
    for i, (q, finger_width_m) in enumerate(zip(motion.q, motion.finger_width_m, strict=True), 1):
        simulator.step(q, finger_width_m)
        if i % every == 0:
            snapshots.append(simulator.snapshot())
    return tuple(snapshots), np.column_stack([motion.q, motion.finger_width_m])


def continue_expert(simulator: Simulator, episode: Episode, state: SimulatorState, expert: Expert) -> Rollout:
    """Let the expert continue an episode from a state for one clip; without commands if nothing is left to do."""
    simulator.reset(episode)
    simulator.restore(state)
    before = simulator.snapshot()
    after, controls = _run_clip(simulator, expert) or ((before,) * CLIP_FRAMES, np.zeros((0, 8)))
    return Rollout(episode=episode, snapshots=(before, *after), controls=controls, outcome=simulator.outcome())


def run_expert(simulator: Simulator, expert: Expert, episode: Episode, *, every: int = STEPS_PER_FRAME) -> Rollout:
    """Let the expert do its task from the start, clip by clip, until success or for the task's number of clips.

    There is a snapshot after each `every` control steps.
    """
    simulator.reset(episode)
    snapshots = [simulator.snapshot()]
    controls = [np.zeros((0, 8))]
    for _ in range(simulator.task.card.clips):
        clip = _run_clip(simulator, expert, every)
        if clip is None:
            break
        snapshots += clip[0]
        controls.append(clip[1])
        if simulator.outcome().success:
            break
    return Rollout(
        episode=episode, snapshots=tuple(snapshots), controls=np.concatenate(controls), outcome=simulator.outcome()
    )


def render_video(simulator: Simulator, snapshots: Sequence[Snapshot], *, first_frame: int = 0) -> RolloutVideo:
    """Render snapshots with the simulator's camera.

    Args:
        simulator: simulator, reset to the scene of the snapshots.
        first_frame: index of the first of them in the whole video, which determines `t_s`.
    """
    images = []
    X_BH = []
    X_BG = []
    for snapshot in snapshots:
        simulator.set_snapshot(snapshot)
        images.append(simulator.render())
        X_BH.append(simulator.link_pose(HAND_LINK))
        X_BG.append(simulator.link_pose(TCP_LINK))
    pixels = {name: np.stack([getattr(image, name) for image in images]) for name in CameraImage.__slots__}
    return RolloutVideo(
        camera=simulator.camera,
        t_s=FRAME_PERIOD_S * np.arange(first_frame, first_frame + len(snapshots), dtype=np.float64),
        q=np.stack([s.q for s in snapshots]),
        finger_width_m=np.array([s.finger_width_m for s in snapshots]),
        X_CH=invert(simulator.camera.X_BC) @ np.stack(X_BH),
        X_BG=np.stack(X_BG),
        **pixels,
    )


def join_videos(parts: Sequence[RolloutVideo], camera: Camera) -> RolloutVideo:
    """Return the frames of several videos one after the other, as the video of one camera."""
    arrays = [field.name for field in fields(RolloutVideo) if field.name != "camera"]
    return RolloutVideo(camera=camera, **{name: np.concatenate([getattr(p, name) for p in parts]) for name in arrays})
