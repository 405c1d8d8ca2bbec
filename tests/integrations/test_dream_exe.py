"""Dream.exe: its cases are read in our frames, and it gets poses in its own."""

import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import UsageError
from kinebench_drake.formats.dream_exe import SITE_M, hand_from_site, read_scene
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.geometry import invert, make_pose, pose_difference, rotation_z, to_quaternion
from kinebench_drake.integrations.dream_exe import PoseBackend
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant

VIDEOS = Path(__file__).parents[2] / "examples" / "videos"
NAME = "CloseLaptopEasy-v1_s0010_unseen"
DOCS = Path(__file__).parents[2] / "docs" / "integrations.md"
FIRST = slice(0, 9)
HAND_FROM_TCP = make_pose(np.eye(3), [0.0, 0.0, 0.1034])
X_WB = make_pose(rotation_z(1.2), [5.0, -1.0, 0.7])
"""Robot in the world of the case."""


@pytest.fixture
def case(tmp_path: Path) -> Path:
    """Workspace with a case and a video of it, as Dream.exe lays them out: an example video in another world."""
    with np.load(VIDEOS / "truth" / f"{NAME}.npz") as truth:
        X_BS = truth["base_from_tcp"][0] @ invert(HAND_FROM_TCP) @ hand_from_site()
    camera = benchmark_camera()
    X_WC = X_WB @ camera.X_BC
    K = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    tcp = {
        name: {"pos": X[:3, 3].tolist(), "quat_wxyz": to_quaternion(X[:3, :3]).tolist()}
        for name, X in (("tcp_base", X_BS), ("tcp_world", X_WB @ X_BS))
    }
    E = {"R_c2w": X_WC[:3, :3].tolist(), "t_c2w": X_WC[:3, 3].tolist()}
    folder = tmp_path / "bench" / "cases" / "rc_x"
    (folder / "env/geometry/eef").mkdir(parents=True)
    (folder / "env/geometry/eef/mesh.obj").touch()
    (folder / "case.json").write_text(json.dumps({"instruction": "Close it."}))
    state = {"camera": {"calibration": {"K": K, "E": E}}, "raw": {"eef": tcp}}
    (folder / "env/environment.json").write_text(json.dumps(state))
    video = tmp_path / "results" / "videos" / "rc_x" / "Wan" / "standard"
    video.mkdir(parents=True)
    for name in ("video", "preprocessed"):
        (video / f"{name}.mp4").write_bytes((VIDEOS / f"{NAME}.mp4").read_bytes())
    about = {"format": "dream-exe.video-output", "uid": "rc_x", "model_id": "Wan", "prompt_variant": "standard"}
    (video / "video.json").write_text(json.dumps(about))
    return folder


def test_videos_have_the_camera_the_state_and_the_prompt_of_their_case(case: Path) -> None:
    (sample,) = find_samples(case.parents[2] / "results").samples
    assert (sample.id, sample.model, sample.prompt) == ("rc_x-Wan-standard", "Wan", "Close it.")
    assert sample.path.name == "preprocessed.mp4"
    assert np.allclose(sample.camera.X_BC, benchmark_camera().X_BC)
    assert sample.initial_state is not None
    with np.load(VIDEOS / "truth" / f"{NAME}.npz") as truth:
        assert np.allclose(sample.initial_state.X_BG, truth["base_from_tcp"][0])


def test_the_published_case_puts_the_base_where_its_joint_angles_put_it(tmp_path: Path) -> None:
    # Numbers of examples/quickstart, case rc_cheesybread_ep000001.
    q = [-0.027196967, -0.986043258, -0.026171683, -2.251129623, 0.00173229, 1.526119515, 0.72794246]
    base = {
        "pos": [0.260537222, -0.016252857, 0.596478767],
        "quat_wxyz": [0.088599838, 0.6962178, 0.705852978, 0.095929232],
    }
    world = {
        "pos": [5.504722103, -0.693698432, 1.296478789],
        "quat_wxyz": [-0.005172338, -0.006734646, 0.991414291, 0.130482167],
    }
    K = {"fx": 401.8395, "fy": 401.8395, "cx": 256.0, "cy": 256.0, "width": 512, "height": 512}
    E = {"R_c2w": np.eye(3).tolist(), "t_c2w": [0.0, 0.0, 0.0]}
    state = {"camera": {"calibration": {"K": K, "E": E}}, "raw": {"eef": {"tcp_base": base, "tcp_world": world}}}
    (tmp_path / "environment.json").write_text(json.dumps(state))
    scene = read_scene(tmp_path / "environment.json")
    position_m, rotation_rad = pose_difference(scene.first.X_BG, ArmPlant().forward_path(np.array([q]))[0])
    assert position_m < 0.002
    assert rotation_rad < 0.002
    X_WB = invert(scene.camera.camera.X_BC)  # the camera stands in the origin of the world
    assert np.allclose(X_WB[:3, 2], [0.0, 0.0, 1.0], atol=1e-3)


@dataclass(frozen=True)
class PoseBackendRequest:
    """Fields of Dream.exe's request that the engine reads."""

    video_frames: Any
    mesh_path: str


@dataclass
class PoseCandidate:
    """As Dream.exe declares it."""

    pose_cam: Any
    valid: bool
    source: str
    pose_quality: float = 0.0
    meta: dict[str, Any] = field(default_factory=dict)


@dataclass
class PosePrediction:
    """As Dream.exe declares it."""

    candidates: list[PoseCandidate]
    meta: dict[str, Any] = field(default_factory=dict)


@pytest.fixture
def contract(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType(PoseBackendRequest.__module__)
    for declared in (PoseBackendRequest, PoseCandidate, PosePrediction):
        setattr(module, declared.__name__, declared)
    monkeypatch.setitem(sys.modules, module.__name__, module)


@pytest.mark.slow
@pytest.mark.usefixtures("contract")
def test_the_engine_gives_the_pose_of_the_mesh_in_every_frame(case: Path) -> None:
    frames = list(read_video(VIDEOS / f"{NAME}.mp4").frames[FIRST])
    mesh = case / "env/geometry/eef/mesh.obj"
    prediction = PoseBackend(period_s=0.2).infer(PoseBackendRequest(video_frames=frames, mesh_path=str(mesh)))
    with np.load(VIDEOS / "truth" / f"{NAME}.npz") as truth:
        X_CS = truth["camera_from_hand"][FIRST] @ hand_from_site()
    assert len(prediction.candidates) == len(frames)
    assert all(candidate.valid and 0.5 < candidate.pose_quality <= 1.0 for candidate in prediction.candidates)
    position_m, rotation_rad = pose_difference(np.stack([c.pose_cam for c in prediction.candidates]), X_CS)
    assert position_m.max() < 0.01
    assert rotation_rad.max() < 0.09
    assert abs(np.linalg.norm(hand_from_site()[:3, 3]) - SITE_M) < 1e-12


@pytest.mark.usefixtures("contract")
def test_frames_that_cannot_be_measured_have_no_valid_candidate(case: Path) -> None:
    request = PoseBackendRequest(
        video_frames=np.zeros((5, 96, 96, 3), np.uint8), mesh_path=str(case / "env/geometry/eef/mesh.obj")
    )
    prediction = PoseBackend().infer(request)
    assert [candidate.valid for candidate in prediction.candidates] == [False] * 5
    assert prediction.candidates[0].meta["reason"]
    with pytest.raises(UsageError, match=r"no environment\.json in the case's folder above it"):
        PoseBackend().infer(PoseBackendRequest(video_frames=request.video_frames, mesh_path="/nowhere/mesh.obj"))


@pytest.mark.usefixtures("contract")
def test_a_run_of_dream_exe_gets_predictions_of_the_engine_that_its_catalog_names(case: Path, tmp_path: Path) -> None:
    # A run works on a copy of the case, and refuses a prediction whose `meta` is not the identity of the catalog.
    run = tmp_path / "work" / "rc_x" / "artifacts"
    for part, name in (("env", "environment.json"), ("init/cad", "eef_mesh_visual_only.obj")):
        (run / part).mkdir(parents=True)
        (run / part / name).write_bytes((case / "env/environment.json").read_bytes() if part == "env" else b"")
    mesh = run / "init/cad/eef_mesh_visual_only.obj"
    request = PoseBackendRequest(video_frames=np.zeros((2, 96, 96, 3), np.uint8), mesh_path=str(mesh))
    row = next(line for line in DOCS.read_text().splitlines() if line.startswith("| models.json"))
    entry = json.loads(row.split("`")[1])["categories"]["exec"]["kinebench"]
    assert entry["factory"] == f"{PoseBackend.__module__}:{PoseBackend.__name__}"
    assert PoseBackend().infer(request).meta == entry["identity"]
