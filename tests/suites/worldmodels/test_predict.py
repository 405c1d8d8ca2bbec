"""The contract "predict" of a world model behind HTTP, by the published service API of WorldArena 2.0."""

import base64
import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import SetupError
from kinebench_drake.suites.worldmodels.http import HttpModel
from kinebench_drake.suites.worldmodels.media import base64_png
from kinebench_drake.suites.worldmodels.remote import Limits
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request, WorldModelError
from tests.films import decoded
from tests.suites.worldmodels.servant import Asked, Reply, Servant


def picture(frame: np.ndarray) -> dict[str, Any]:
    form = {"encoding": "png_base64", "color_space": "RGB", "height": frame.shape[0], "width": frame.shape[1]}
    return {**form, "channels": 3, "data": base64_png(frame)}


def answer_to(asked: Asked, frames: list[Any]) -> dict[str, Any]:
    echo = {name: asked.body[name] for name in ("api_version", "request_id", "model_version")}
    return {**echo, "predictions": [{"sample_id": asked.body["samples"][0]["sample_id"], "frames": frames}]}


@pytest.fixture
def profile() -> dict[str, Any]:
    """Profile of the server, 96 x 64 px."""
    return {
        "profile_id": "franka",
        "image": {"encoding": "png_base64", "color_space": "RGB", "height": 64, "width": 96, "channels": 3},
        "context_frames": {"min": 1, "max": 8},
        "prediction_frames": {"min": 1, "max": 16},
        "action": {"dtype": "float32", "dimension": 8, "representation": "profile_canonical"},
        "instruction": {"supported": True},
    }


@pytest.fixture
def server(servant: Servant, profile: dict[str, Any]) -> Servant:
    """Server whose frames are as grey as their number in tens, the conditioning frame being 0."""

    def predict(asked: Asked) -> Reply:
        (sample,) = asked.body["samples"]
        height, width = (sample["context"]["frames"][0][side] for side in ("height", "width"))
        greys = (np.full((height, width, 3), 10 * i, np.uint8) for i in range(1, len(sample["actions"]) + 1))
        return Reply(answer_to(asked, [picture(grey) for grey in greys]))

    other = {**profile, "profile_id": "two-arms", "action": {"dimension": 14}}
    about = {"api_version": "1.0", "model_version": "wm-1"}
    servant.routes |= {
        "/v1/health": [Reply({"status": "ready", **about})],
        "/v1/capabilities": lambda asked: Reply({**about, "profiles": [other, profile]}),
        "/v1/predict": predict,
    }
    return servant


@pytest.fixture
def generate(
    server: Servant, hurried: Limits, request_: Request, actions: ActionTrack, out: Path
) -> Callable[..., Path]:
    black = np.zeros((64, 96, 3), np.uint8)

    def generated(path: str = "?timeout=20") -> Path:
        model = HttpModel(parse(f"http:{server.url}{path}"), hurried)
        return model.generate(replace(request_, first_frame=black, actions=actions), out)

    return generated


@pytest.mark.parametrize("path", ["", "/", "/v1/predict", "?style=predict"])
def test_the_clip_is_the_first_frame_and_one_frame_for_each_action(
    generate: Callable[..., Path], path: str, out: Path
) -> None:
    video = generate(path)
    frames = decoded(video)[1]
    assert frames.shape == (5, 64, 96, 3)
    assert np.abs(frames.mean((1, 2, 3)) - 10 * np.arange(5)).max() < 3
    assert list(out.parent.iterdir()) == [video]


def test_requests_have_every_required_field(
    generate: Callable[..., Path], server: Servant, profile: dict[str, Any], actions: ActionTrack, request_: Request
) -> None:
    profile["context_frames"]["min"] = 2
    profile["image"].update(width=48, height=32)
    generate()
    (asked,) = server.at("/v1/predict")
    body = asked.body
    assert (body["api_version"], body["model_version"], body["profile_id"]) == ("1.0", "wm-1", "franka")
    (sample,) = body["samples"]
    assert sample["seed"] == request_.seed
    assert sample["context"]["instruction"] == request_.prompt
    vectors = np.column_stack([actions.q, actions.finger_width_m])
    assert np.allclose(sample["context"]["actions"], vectors[:1])
    assert np.allclose(sample["actions"], vectors[1:])
    for frame in sample["context"]["frames"]:
        assert (frame["encoding"], frame["color_space"], frame["channels"]) == ("png_base64", "RGB", 3)
        assert Image.open(io.BytesIO(base64.b64decode(frame["data"], validate=True))).size == (48, 32)


def test_clips_are_no_longer_than_the_profile_allows(generate: Callable[..., Path], profile: dict[str, Any]) -> None:
    profile["prediction_frames"]["max"] = 2
    assert len(decoded(generate())[1]) == 3


def test_a_retry_repeats_the_request_with_its_id(generate: Callable[..., Path], server: Servant) -> None:
    predict = server.routes["/v1/predict"]
    server.routes["/v1/predict"] = lambda asked: (
        predict(asked) if server.at("/v1/predict") else Reply({"error": {"code": "OVERLOADED"}}, status=429)
    )
    generate()
    first, second = server.at("/v1/predict")
    assert first.body == second.body


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"request_id": "another"}, "has request_id another"),
        ({"model_version": None}, "has model_version None"),
        ({"predictions": None}, "no frames of sample-0, expected 4"),
        ({"predictions": []}, "no frames of sample-0, expected 4"),
        ({"predictions": [{"sample_id": "x", "frames": [{}] * 4}]}, "no frames of sample-0"),
        ({"predictions": [{"sample_id": "sample-0", "frames": [{}] * 5}]}, "5 frames of sample-0, expected 4"),
        ({"predictions": [{"sample_id": "sample-0", "frames": [{}] * 4}]}, "frame 0 is not a picture object"),
        ({"predictions": [{"sample_id": "sample-0", "frames": [{"data": "%"}] * 4}]}, "frame 0 is not a picture"),
        ({"error": "out of memory"}, "gave no frames: out of memory"),
    ],
)
def test_unusable_answers_are_refused(
    generate: Callable[..., Path], server: Servant, change: dict[str, Any], message: str, out: Path
) -> None:
    server.routes["/v1/predict"] = lambda asked: Reply({**answer_to(asked, []), **change})
    with pytest.raises(WorldModelError, match=message):
        generate()
    assert list(out.parent.iterdir()) == []


@pytest.mark.parametrize("side", [2, 2**14])
def test_pictures_of_another_size_are_refused_before_they_are_decoded(
    generate: Callable[..., Path], server: Servant, side: int
) -> None:
    head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + side.to_bytes(4, "big") * 2 + b"\x08\2\0\0\0\0\0\0\0"
    frames = [{"data": base64.b64encode(head).decode()}] * 4
    server.routes["/v1/predict"] = lambda asked: Reply(answer_to(asked, frames))
    with pytest.raises(WorldModelError, match=rf"frame 0 (has {side} x {side} pixels, expected 96 x 64|is not a pic)"):
        generate()


def test_servers_that_do_not_fit_are_setup_errors(
    generate: Callable[..., Path], server: Servant, profile: dict[str, Any], request_: Request, out: Path
) -> None:
    with pytest.raises(SetupError, match="run with --condition actions"):
        HttpModel(parse(server.url)).generate(request_, out)
    profile["action"]["dimension"] = 7
    with pytest.raises(SetupError, match="profiles: two-arms with 14, franka with 7; expected one with 8 numbers"):
        generate()
    profile["context_frames"]["min"] = 10_000  # a request holds that many pictures
    with pytest.raises(SetupError, match=r"capabilities: profiles\.\d\.context_frames\.min"):
        generate()
    profile["image"]["width"] = 8192
    with pytest.raises(SetupError, match=r"capabilities: profiles\.\d\.image\.width"):
        generate()
    server.routes["/v1/health"] = [Reply({"status": "starting"})]
    with pytest.raises(SetupError, match="its health is 'starting'"):
        generate()
    server.routes["/v1/capabilities"] = [Reply(status=500)]
    with pytest.raises(WorldModelError, match="HTTP 500"):  # it is not taken for a server of the other contract
        generate()
