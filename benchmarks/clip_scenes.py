"""Motions, cameras and files of the clips that other simulators render.

Scripts import it in environments of their own, so it needs no more than numpy and av.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import av
import numpy as np
from numpy.typing import NDArray

SHAPES = ((384, 384), (640, 480), (512, 320), (480, 480), (256, 256))
"""Width and height of the clips in turn [px]."""
HAND_TO_TCP_M = 0.1034
PERIOD_S = 0.2
"""Time between two frames [s]."""
FINGER_M = 0.04
NO_FAULT = "none"
FAULTS = ("vanish", "teleport", "freeze", "deformation")
_LENGTHS = {"vanish": range(6, 13), "freeze": range(6, 10)}
"""Numbers of frames without hand and fingers, and that repeat the frame before them; other faults last to the end."""
_FAULT_PX = 800
"""Least pixels of the gripper where a fault begins, in an image of 384 px."""
_WATCHED_FRAMES = 13
"""Frames in which it has as many, from the last one before the fault on, at most to the end of the fault."""
_LEAST_SPEED_M_S = 0.03
"""Least speed of the TCP in each step that a freeze leaves out."""
_JUMP_M = (0.05, 0.12)
"""Least and greatest distance of the TCP in a teleport from its last place, and from where the plain motion has it."""
_JUMP_RAD = 0.1
"""Standard deviation of the joints' steps in a teleport."""
_TRIES = 20
_WORKSPACE = np.array([[0.32, 0.62], [-0.3, 0.3], [0.06, 0.4]])
"""Box of the TCP's positions in the base frame [m]."""
_LEAST_PX = 300
"""Pixels of the gripper from which it is visible, in an image of 384 px."""
_LEAST_SHARE = 0.8
"""Least share of the frames in which it is visible."""


class SceneArm(Protocol):
    """The Panda in a scene of a simulator."""

    limits: NDArray[Any]
    """Least and greatest angles (7, 2) of the joints [rad]."""

    @property
    def X_BH(self) -> NDArray[Any]:
        """Pose (4, 4) of panda_hand in the base frame [m]."""
        ...

    def set(self, q: NDArray[Any], width_m: float) -> None:
        """Pose the arm (7,) [rad] and the fingers, `width_m` apart."""
        ...

    def offset(self, X_BH: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the shift (3,) [m] and the rotation vector (3,) [rad] from the hand to a pose, in the world."""
        ...

    def jacobian(self) -> NDArray[Any]:
        """Return the Jacobian (6, 7) of the hand's position and rotation, in the world."""
        ...

    def render(
        self, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any], fault: str = NO_FAULT
    ) -> Iterator[tuple[NDArray[Any], int]]:
        """Yield images (H, W, 3) and the pixels of hand and fingers; the arm stays posed as the image shows.

        A vanish hides hand and fingers, a deformation stretches them, and other faults do not change their look.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Take:
    """Motion that a clip shows, and the fault in it."""

    q: NDArray[Any]
    """Postures (T, 7) [rad]."""
    gap: NDArray[Any]
    """Gaps of the fingers (T,) [m]."""
    fault: str = NO_FAULT
    first: int = 0
    """First frame of the fault; the last one is `last`."""
    last: int = -1


def solve(arm: SceneArm, X_BH: NDArray[Any], q: NDArray[Any]) -> NDArray[Any] | None:
    """Return the posture (7,) that reaches a pose of the hand, from `q` on; None if none is found."""
    for _ in range(200):
        arm.set(q, FINGER_M)
        off, turn = arm.offset(X_BH)
        if np.linalg.norm(off) < 1e-3 and np.linalg.norm(turn) < 1e-2:
            return q
        J = arm.jacobian()
        step = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(6), np.concatenate([off, turn]))
        q = np.clip(q + np.clip(step, -0.2, 0.2), arm.limits[:, 0] + 0.05, arm.limits[:, 1] - 0.05)
    return None


def motion(
    arm: SceneArm, frames: int, rng: np.random.Generator, *, lift_m: float = 0.0
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return postures (T, 7) [rad] and finger gaps (T,) [m] of a smooth motion through random poses of the hand.

    The workspace is lifted by `lift_m`.
    """
    q = np.array([0.0, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
    targets = list[NDArray[Any]]()
    stops = max(2, round(frames / 16) + 1)
    while len(targets) < stops:
        tilt = rng.normal(0.0, 0.3, 2)
        turn = rng.uniform(-1.2, 1.2)
        X = np.eye(4)
        X[:3, :3] = _turn(2, turn) @ _turn(0, np.pi + tilt[0]) @ _turn(1, tilt[1])
        X[:3, 3] = rng.uniform(*_WORKSPACE.T) - HAND_TO_TCP_M * X[:3, 2]
        X[2, 3] += lift_m
        reached = solve(arm, X, q)
        if reached is not None and (not targets or np.abs(reached - targets[-1]).max() < 0.5 * np.pi):
            targets.append(reached)
            q = reached
    s = np.linspace(0.0, stops - 1, frames)
    first = np.minimum(s.astype(int), stops - 2)
    u = s - first
    u = u**3 * (10 - 15 * u + 6 * u**2)  # minimum jerk (Flash and Hogan 1985)
    postures = np.array(targets)
    gap = rng.uniform(0.0, 2 * FINGER_M, stops)
    blend = (1 - u)[:, None], u[:, None]
    return (
        blend[0] * postures[first] + blend[1] * postures[first + 1],
        blend[0][:, 0] * gap[first] + blend[1][:, 0] * gap[first + 1],
    )


def _turn(axis: int, angle: float) -> NDArray[Any]:
    R = np.eye(3)
    i = (axis + 1) % 3
    j = (axis + 2) % 3
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j] = -np.sin(angle)
    R[j, i] = np.sin(angle)
    return R


def random_camera(width: int, height: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return a camera.json object: in front of or beside the robot, upright, looking at its workspace."""
    fov = np.deg2rad(rng.uniform(36.0, 65.0))
    focal = height / 2 / np.tan(fov / 2)
    azimuth = rng.uniform(-1.7, 1.7)
    elevation = rng.uniform(0.1, 1.05)
    target = np.array([0.3, 0.0, 0.25]) + rng.normal(0.0, 0.08, 3)
    distance = rng.uniform(0.75, 1.15) / np.tan(fov / 2) * 0.55
    away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    return camera_json(width, height, focal, look_at(target + distance * away, target))


def look_at(eye: NDArray[Any], target: NDArray[Any]) -> NDArray[Any]:
    """Return the pose (4, 4) of an upright camera at `eye` that looks at `target`; OpenCV axes."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    X = np.eye(4)
    X[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    X[:3, 3] = eye
    return X


def camera_json(width: int, height: int, focal: float, X_BC: NDArray[Any]) -> dict[str, Any]:
    """Return the object of camera.json of a centred camera."""
    return {
        "width": width, "height": height, "fx": focal, "fy": focal, "cx": width / 2, "cy": height / 2,
        "base_from_camera": X_BC.tolist(),
    }  # fmt: skip


def is_visible(arm: SceneArm, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any]) -> bool:
    """Return whether a camera shows the gripper in most of some frames."""
    some = np.linspace(0, len(q) - 1, 5).round().astype(int)
    return bool(np.mean([*_shows(arm, camera, q[some], gap[some], _LEAST_PX)]) >= _LEAST_SHARE)


def _shows(
    arm: SceneArm, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any], least_px: float
) -> Iterator[bool]:
    """Yield whether images show the gripper with as many pixels as `least_px` are in an image of 384 px."""
    least = least_px * min(camera["width"], camera["height"]) ** 2 / 384**2
    return (count >= least for _, count in arm.render(camera, q, gap))


def plant(
    fault: str, arm: SceneArm, camera: dict[str, Any], q: NDArray[Any], gap: NDArray[Any], rng: np.random.Generator
) -> Take | None:
    """Return a motion with a fault that begins in the middle half of the clip, with the gripper in view.

    Return None if none of some random places has room for it.
    """
    if fault == NO_FAULT:
        return Take(q=q, gap=gap)
    frames = len(q)
    path = _tcp_path(arm, q)
    for _ in range(_TRIES):
        length = int(rng.choice(_LENGTHS.get(fault, range(1))))
        first = frames // 2 if fault == "deformation" else int(rng.integers(frames // 4, 3 * frames // 4 - length))
        last = first + length - 1 if length else frames - 1
        take = Take(q=q.copy(), gap=gap.copy(), fault=fault, first=first, last=last)
        if fault == "freeze":
            take.q[first : last + 1] = q[first - 1]
            take.gap[first : last + 1] = gap[first - 1]
            steps = np.diff(path[first - 1 : last + 2], axis=0)
            if np.linalg.norm(steps, axis=1).min() < _LEAST_SPEED_M_S * PERIOD_S:
                continue
        if fault == "teleport":
            take.q[first:] += rng.normal(0.0, _JUMP_RAD, 7)
            if not _is_jump(arm, take, path):
                continue
        watched = slice(first - 1, min(last + 1, first - 1 + _WATCHED_FRAMES))
        if all(_shows(arm, camera, take.q[watched], take.gap[watched], _FAULT_PX)):
            return take
    return None


def _tcp_path(arm: SceneArm, q: NDArray[Any]) -> NDArray[Any]:
    """Return the positions (T, 3) of the TCP in the base frame [m]."""
    path = []
    for posture in q:
        arm.set(posture, FINGER_M)
        path.append(arm.X_BH[:3, 3] + HAND_TO_TCP_M * arm.X_BH[:3, 2])
    return np.array(path)


def _is_jump(arm: SceneArm, take: Take, plain: NDArray[Any]) -> bool:
    """Return whether a path jumps visibly, keeps the limits, and goes no lower than the plain path (T, 3) [m]."""
    path = _tcp_path(arm, take.q)
    jumps_m = np.linalg.norm(path[take.first] - [path[take.first - 1], plain[take.first]], axis=1)
    within = (take.q > arm.limits[:, 0]) & (take.q < arm.limits[:, 1]) & (path[:, 2:] >= plain[:, 2].min())
    return bool(jumps_m.min() >= _JUMP_M[0] and jumps_m.max() <= _JUMP_M[1] and within.all())


def write_video(path: Path, frames: Sequence[NDArray[Any]]) -> None:
    """Write images (H, W, 3) as H.264."""
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=17, options={"crf": "20"})
        stream.height, stream.width, _ = frames[0].shape
        stream.pix_fmt = "yuv420p"
        for image in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode())


def write_clip(folder: Path, name: str, arm: SceneArm, camera: dict[str, Any], take: Take) -> None:
    """Render a clip and write it with its truth and its line of the manifest."""
    frames = []
    visible = []
    X_BH = []
    for fault, part in (
        (NO_FAULT, slice(take.first)),
        (take.fault, slice(take.first, take.last + 1)),
        (NO_FAULT, slice(take.last + 1, None)),
    ):
        for image, count in arm.render(camera, take.q[part], take.gap[part], fault):
            frames.append(image)
            visible.append(count)
            X_BH.append(arm.X_BH)
    write_video(folder / f"{name}.mp4", frames)
    tcp = np.eye(4)
    tcp[2, 3] = HAND_TO_TCP_M
    poses = np.array(X_BH)
    planted: dict[str, Any] = (
        {} if take.fault == NO_FAULT else {"fault": take.fault, "fault_frames": (take.first, take.last)}
    )
    np.savez_compressed(
        folder / f"{name}.gt.npz",
        base_from_hand=poses, base_from_tcp=poses @ tcp, q=take.q, finger_width_m=take.gap,
        visible=np.array(visible), **planted,
    )  # fmt: skip
    with (folder / "manifest.jsonl").open("a") as manifest:
        manifest.write(
            json.dumps({"video": f"{name}.mp4", "frame_period_s": PERIOD_S, "camera": camera, **planted}) + "\n"
        )


def clip_parser(title: str, prefix: str, faults: Sequence[str] = FAULTS) -> argparse.ArgumentParser:
    """Return the parser of the options that all scripts have; `faults` are the kinds that the simulator shows."""

    def kinds(text: str) -> list[str]:
        if not {NO_FAULT, *faults}.issuperset(text.split(",")):
            raise argparse.ArgumentTypeError(f"expected kinds among {NO_FAULT}, {', '.join(faults)}")
        return text.split(",")

    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=14)
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--frames", type=int, default=49)
    parser.add_argument("--prefix", default=prefix)
    parser.add_argument(
        "--faults", type=kinds, default=[NO_FAULT], help=f"of clips in turn: {NO_FAULT},{','.join(faults)}"
    )
    parser.add_argument("--size", help="WxH of all clips; default: five shapes in turn")
    return parser


def missing_clips(options: argparse.Namespace) -> Iterator[tuple[int, str, tuple[int, int], str, np.random.Generator]]:
    """Yield number, name, width and height [px], fault and generator of each clip that the output folder lacks."""
    options.out.mkdir(parents=True, exist_ok=True)
    for number in range(options.count):
        name = f"{options.prefix}{number:02d}"
        if (options.out / f"{name}.gt.npz").exists():
            continue
        width, height = (
            tuple(map(int, options.size.split("x"))) if options.size else SHAPES[(number // 2) % len(SHAPES)]
        )
        fault = options.faults[number % len(options.faults)]
        yield number, name, (width, height), fault, np.random.default_rng([options.seed, number])
        print(name, flush=True)
