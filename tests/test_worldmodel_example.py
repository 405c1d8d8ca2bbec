"""The learned world model of examples/worldmodel: laws that hold before any training."""

import threading

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from examples.worldmodel.autoencoder import Autoencoder, to_uv
from examples.worldmodel.generator import Generator, make_server
from examples.worldmodel.pack import FRAMES, measure_pose, read_pack
from examples.worldmodel.robot import POSE, SIZE, span_parts
from examples.worldmodel.training import TrainConfig, train
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import SetupError
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.suites.worldmodels.factory import create
from kinebench_drake.suites.worldmodels.worldmodel import Request

HAND = 6
"""Index of the hand among the parts."""


@pytest.fixture(scope="module")
def plant():
    return ArmPlant()


@pytest.fixture(scope="module")
def poses(plant):
    """Pose numbers of a short motion, and the poses of the hand in the camera's frame."""
    return record(plant, np.linspace([0, 0.4, 0, -2, 0, 2.4, 0.8], [0.3, 0.6, 0.1, -1.8, 0.2, 2.2, 0.9], 5))


def record(plant, q):
    camera = benchmark_camera()
    X_CB = np.linalg.inv(camera.X_BC)
    X_CH = np.array([X_CB @ plant.link_poses(row)["panda_hand"] for row in q])
    truth = {
        "q": q,
        "finger_width_m": np.full(len(q), 0.04),
        "camera_from_hand": X_CH,
        "base_from_object": np.tile(np.eye(4), (len(q), 1, 1, 1)),
        "joint_position": np.empty((len(q), 0)),
    }
    return measure_pose(camera.to_json(), truth, plant), X_CH


@pytest.fixture(scope="module")
def pack(tmp_path_factory, poses):
    """Two clips of noise, with pose numbers."""
    folder = tmp_path_factory.mktemp("pack")
    for seed in range(2):
        path = folder / "train" / f"PullCube-v1_s{seed:04d}.mp4"
        path.parent.mkdir(exist_ok=True)
        write_video(path, np.random.default_rng(seed).integers(0, 255, (5, SIZE, SIZE, 3), dtype=np.uint8), 17)
        np.savez(path.with_suffix(".npz"), poses=poses[0], prompt=f"Pull cube {seed}.")
    return folder


@pytest.fixture(scope="module")
def weights(pack, tmp_path_factory):
    """Weights of both stages after one step."""
    out = tmp_path_factory.mktemp("weights")
    for stage in ("autoencoder", "dynamics"):
        train(TrainConfig(stage=stage, pack=pack, out=out, minutes=5, steps=1, batch=2))
    return out


def test_pose_numbers_span_the_hand_at_its_pose(poses):
    numbers, X_CH = poses
    origin, axes = span_parts(torch.from_numpy(numbers))
    np.testing.assert_allclose(origin[:, HAND], X_CH[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(axes[:, HAND], X_CH[:, :3, :3].transpose(0, 2, 1), atol=1e-4)


def test_short_clips_repeat_their_last_frame(pack):
    frames, numbers, _ = read_pack(pack, "train")
    assert frames.shape == (2, FRAMES, SIZE, SIZE, 3)
    assert numbers.shape == (2, FRAMES, POSE)
    assert (frames[:, 5:] == frames[:, 4:5]).all()


def test_a_pack_is_read_up_to_the_number_of_demonstrations(pack):
    assert read_pack(pack, "train", 1)[2] == ["Pull cube 0."]
    assert read_pack(pack, "test")[2] == []


def test_pixels_do_not_depend_on_the_pixels_painted_beside_them(poses):
    model = Autoencoder().eval()
    first = torch.rand(1, 3, SIZE, SIZE)
    numbers = torch.from_numpy(poses[0])[None]
    uv = to_uv(torch.randint(SIZE, (1, 5, 40, 2)))
    with torch.no_grad():
        together, _ = model(first, numbers[:, 0], numbers, uv)
        alone, _ = model(first, numbers[:, 0], numbers[:, 2:3], uv[:, 2:3, 7:9])
    torch.testing.assert_close(alone[0, 0], together[0, 2, 7:9], atol=1e-5, rtol=0)


@pytest.mark.parametrize("stage", ["autoencoder", "dynamics"])
def test_a_training_that_was_stopped_goes_on_as_if_it_had_not_been(pack, tmp_path, stage):
    def run(out, steps):
        config = TrainConfig(stage=stage, pack=pack, out=tmp_path / out, minutes=5, steps=steps, batch=2)
        assert train(config) == steps
        return load_file(tmp_path / out / f"{stage}.safetensors")

    run("stopped", 1)
    stopped = run("stopped", 2)
    through = run("through", 2)
    for name, value in through.items():
        assert torch.equal(stopped[name], value), name


def test_videos_begin_with_the_first_frame_and_depend_on_the_seed(weights):
    generator = Generator(weights)
    first = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    video = generator.generate(first, "Pull the cube.", 1, 3)
    assert video.shape == (3, 64, 64, 3)
    assert (video[0] == first).all()
    assert (video == generator.generate(first, "Pull the cube.", 1, 3)).all()
    assert (video != generator.generate(first, "Pull the cube.", 2, 3)).any()


def test_missing_weights_are_an_error_with_the_fix(tmp_path):
    with pytest.raises(SetupError, match=r"autoencoder\.safetensors is missing"):
        Generator(tmp_path)


@pytest.fixture(params=["class", "server"])
def spec(request, weights):
    """The model as `--world-model` names it."""
    if request.param == "class":
        yield f"examples.worldmodel.generator:Learned?weights={weights}"
        return
    server = make_server(Generator(weights), 0)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}?timeout=60"
    server.shutdown()
    server.server_close()


def test_the_model_answers_a_request(spec, tmp_path):
    request = Request(
        episode="PullCube-v1_s0003",
        task="PullCube-v1",
        round=0,
        prompt="Pull the cube.",
        negative_prompt="",
        seed=1,
        first_frame=np.zeros((64, 64, 3), np.uint8),
        num_frames=4,
        fps=17.0,
    )
    assert read_video(create(spec).generate(request, tmp_path / "answer")).frames.shape == (4, 64, 64, 3)
