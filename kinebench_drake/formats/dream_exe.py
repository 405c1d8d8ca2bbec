"""Cases and videos of Dream.exe (https://github.com/showlab/Dream.exe).

    bench/cases/UID/env/environment.json                     camera, robot and state of the first frame
    bench/cases/UID/case.json                                instruction
    results/videos/UID/MODEL/VARIANT/video.json              uid, model; beside it video.mp4 and preprocessed.mp4

The base of the arm is the body to which the pose of the gripper's site refers: link0 of robosuite's Panda. The site
lies on the z axis of panda_hand, turned about it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinebench_drake.camera import CameraSetting, CameraSource
from kinebench_drake.errors import InputError
from kinebench_drake.formats.trajectories.reading import TOOLS
from kinebench_drake.formats.videos.sample import Search, VideoSample
from kinebench_drake.geometry import Array, from_quaternion, invert, make_pose, rotation_z
from kinebench_drake.io.jsonl import as_object, as_type, read_object
from kinebench_drake.track import InitialState

ENVIRONMENT = "environment.json"
_VIDEO = "video.json"
_FORMAT = "dream-exe.video-output"
SITE_M = 0.097
"""Distance of robosuite's grip site from panda_hand along z [m]."""


def hand_from_site() -> Array:
    """Return the pose X_HS (4, 4) of the grip site, in which meshes of the gripper are stored, in panda_hand [m]."""
    return make_pose(rotation_z(-0.5 * np.pi), [0.0, 0.0, SITE_M])


@dataclass(frozen=True, slots=True, kw_only=True)
class DreamScene:
    """Camera and robot of a case in its first frame."""

    camera: CameraSetting
    first: InitialState


def read_scene(path: Path) -> DreamScene:
    """Read an environment.json.

    Raises:
        InputError: it is damaged, or lacks a number.
        UsageError: its camera is unusable.
    """
    state = read_object(path)
    calibration = as_object(as_object(state.get("camera")).get("calibration"))
    eef = as_object(as_object(state.get("raw")).get("eef"))
    K = as_object(calibration.get("K"))
    E = as_object(calibration.get("E"))
    try:
        X_WC = make_pose(np.array(E.get("R_c2w"), dtype=np.float64), np.array(E.get("t_c2w"), dtype=np.float64))
        X_WS, X_BS = (_pose(as_object(eef.get(name))) for name in ("tcp_world", "tcp_base"))
    except (TypeError, ValueError) as error:
        raise InputError(f"{path.name}: no camera and pose of the gripper as Dream.exe writes them ({error})") from None
    camera = CameraSetting.from_json({**K, "base_from_camera": (X_BS @ invert(X_WS) @ X_WC).tolist()}, path.name)
    return DreamScene(camera=camera, first=InitialState(X_BG=X_BS @ invert(hand_from_site()) @ TOOLS["hand"]))


def _pose(pose: Mapping[str, object]) -> Array:
    return from_quaternion(np.array(pose.get("quat_wxyz"), dtype=float), np.array(pose.get("pos"), dtype=float))


def is_dream_exe(folder: Path) -> bool:
    """Return whether a folder holds a video with its description."""
    try:
        return read_object(folder / _VIDEO).get("format") == _FORMAT
    except (FileNotFoundError, NotADirectoryError, InputError):
        return False


def list_dream_exe(folder: Path, search: Search) -> list[VideoSample]:
    """List the video that is evaluated, with the camera and the first state of its case where that is there.

    Raises:
        InputError: a file is damaged, or there is no video.
        UsageError: a camera is unusable.
    """
    about = read_object(folder / _VIDEO)
    uid, model = (as_type(about.get(name), str) or "unnamed" for name in ("uid", "model_id"))
    variant = as_type(about.get("prompt_variant"), str) or folder.resolve().name
    videos = [folder / name for name in ("preprocessed.mp4", "video.mp4") if (folder / name).is_file()]
    if not videos:
        raise InputError("holds neither preprocessed.mp4 nor video.mp4")
    sample = replace(search.part_sample(videos[0]), id=f"{uid}-{model}-{variant}", task=uid, model=model)
    cases = (top / "bench" / "cases" / Path(uid).name for top in folder.resolve().parents)
    case = next((path for path in cases if (path / "env" / ENVIRONMENT).is_file()), None)
    if case is None:
        return [sample]
    scene = read_scene(case / "env" / ENVIRONMENT)
    prompt = (
        as_type(read_object(case / "case.json").get("instruction"), str) if (case / "case.json").is_file() else None
    )
    sample = sample.filmed_by(scene.camera, CameraSource.FOLDER)
    return [replace(sample, prompt=prompt, initial_state=scene.first)]
