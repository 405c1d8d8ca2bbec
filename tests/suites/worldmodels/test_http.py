"""Both contracts of a world model behind HTTP."""

import base64
import io
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.suites.worldmodels import http
from kinebench_drake.suites.worldmodels.http import HttpModel
from kinebench_drake.suites.worldmodels.media import base64_png, from_base64, png
from kinebench_drake.suites.worldmodels.remote import Limits
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request, WorldModelError
from tests.films import decoded
from tests.suites.worldmodels.servant import Asked, Reply, Servant


@pytest.fixture
def ask(servant: Servant, hurried: Limits, keys: str, request_: Request, out: Path) -> Callable[..., Path]:
    """Answers of `/make`, a server that keeps the simple contract."""

    def answered(answer: Any, *, status: int = 200, options: str = "", timeout: int = 20) -> Path:
        servant.routes["/make"] = [Reply(answer, status=status)]
        model = HttpModel(parse(f"{servant.url}/make?timeout={timeout}{options}"), hurried)
        return model.generate(request_, out)

    return answered


def base64_of(data: bytes) -> str:
    return base64.b64encode(data).decode()


def test_the_simple_protocol_posts_the_request_and_returns_the_video(
    ask: Callable[..., Path], servant: Servant, film: bytes, request_: Request
) -> None:
    path = ask({"video_base64": base64_of(film)})
    assert path.read_bytes() == film
    (asked,) = servant.at("/make")
    assert asked.method == "POST"
    assert "Authorization" not in asked.headers
    picture = asked.body.pop("first_frame").removeprefix("data:image/png;base64,")
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(base64.b64decode(picture)))), request_.first_frame)
    assert asked.body == {
        "prompt": request_.prompt,
        "negative_prompt": "blur",
        "seed": 2**31 + 7,
        "num_frames": 5,
        "size": [96, 64],
        "fps": 17.0,
    }


def test_a_server_gets_the_requested_actions_as_json(
    servant: Servant, hurried: Limits, keys: str, request_: Request, actions: ActionTrack, out: Path, film: bytes
) -> None:
    servant.routes["/make"] = [Reply({"video_base64": base64_of(film)})]
    HttpModel(parse(f"{servant.url}/make?timeout=20"), hurried).generate(replace(request_, actions=actions), out)
    (asked,) = servant.at("/make")
    assert asked.body["actions"] == actions.to_json()


def test_path_url_and_base64_answers_give_the_same_video(
    ask: Callable[..., Path], servant: Servant, film: bytes, tmp_path: Path
) -> None:
    (tmp_path / "made.bin").write_bytes(film)
    servant.routes["/v"] = [Reply(film)]
    for answer in (
        {"video_path": str(tmp_path / "made.bin")},
        {"video_url": f"{servant.url}/v", "video_path": None},
        {"video_base64": f"data:video/mp4;base64,{base64_of(film)}"},
    ):
        assert ask(answer).read_bytes() == film
    assert (tmp_path / "made.bin").is_file()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ({}, "has no video; expected exactly one of video_path, video_url, video_base64"),
        ({"video_url": "http://a", "video_base64": "x"}, "has video_url and video_base64; expected exactly one"),
        ({"video_base64": 7}, "has video_base64; expected .* a string"),
        ({"error": "no\nidea"}, "gave no video: no idea"),
        ({"error": "late", "video_path": "/x"}, r"gave no video: late \(and video_path beside the error"),
        ({"video_base64": "%%%"}, "not base64"),
        ({"video_base64": "AAAA"}, "not a video"),
        ({"video_base64": ""}, "it is empty"),
        ({"video_path": "made.mp4"}, "not an absolute path"),
        ({"video_path": "/nonexistent"}, "cannot be read"),
        ({"video_path": f"/{'x' * 300}"}, "cannot be read"),
        ({"video_path": "/a\0b"}, "cannot be read"),
        ({"video_path": "/dev/zero"}, "cannot be read"),
        ({"video_path": "/proc/self/mem"}, "cannot be read"),
        ({"video_path": "/etc/hostname"}, "not a video"),
        ({"video_url": "file:///etc/hostname"}, "not http or https"),
        ([], r"expected a JSON object; it begins: '\[\]'"),
        ({"video_base64": "A" * 40_000}, r"more than 0\.019\S+ MiB of video"),
    ],
)
def test_answers_without_exactly_one_video_are_refused(
    ask: Callable[..., Path], answer: Any, message: str, out: Path
) -> None:
    with pytest.raises(WorldModelError, match=message):
        ask(answer)
    assert list(out.parent.iterdir()) == []


def test_a_video_path_is_bounded_in_size_and_time(
    ask: Callable[..., Path], tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    large = tmp_path / "sparse.mp4"
    with large.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(WorldModelError, match=r"more than 0\.019\S* MiB of video"):
        ask({"video_path": str(large)})
    monkeypatch.setattr(http, "_pieces", lambda path: (time.sleep(0.05) or b"" for _ in range(1000)))
    with pytest.raises(WorldModelError, match="no video within 1 s"):
        ask({"video_path": str(large)}, timeout=1)
    assert list(out.parent.iterdir()) == []


def test_a_video_path_is_accepted_only_from_this_machine(hurried: Limits, tmp_path: Path, film: bytes) -> None:
    (tmp_path / "v.mp4").write_bytes(film)
    model = HttpModel(parse("https://example.org/make"), hurried)
    with pytest.raises(WorldModelError, match="only from a server on this machine"):
        model._fetch({"video_path": str(tmp_path / "v.mp4")}, tmp_path / "part", None)  # no server there to ask


def test_a_key_is_masked_for_any_name_of_its_variable(
    ask: Callable[..., Path], servant: Servant, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WORLD_MODEL_AUTH", "sk-12345678")
    with pytest.raises(WorldModelError) as raised:
        ask({"error": "no quota for sk-12345678"}, options="&key_env=WORLD_MODEL_AUTH")
    assert "sk-12345678" not in str(raised.value)
    assert "***" in str(raised.value)


def test_a_key_is_sent_only_with_key_env_and_over_https(
    ask: Callable[..., Path], servant: Servant, film: bytes, keys: str
) -> None:
    ask({"video_base64": base64_of(film)}, options="&key_env=MY_API_KEY")
    assert {asked.headers["Authorization"] for asked in servant.asked} == {f"Bearer {keys}"}
    with pytest.raises(SetupError, match="only over https"):
        HttpModel(parse("http://example.org?key_env=MY_API_KEY"))
    with pytest.raises(SetupError, match="NO_SUCH is not set"):
        HttpModel(parse("http://localhost?key_env=NO_SUCH"))


@pytest.mark.parametrize(
    "spec", ["http:", "http://", "http:file:///x", "http://u:pass@h/", "http://h/?a", "http://h/#a"]
)
def test_unusable_addresses_are_usage_errors(spec: str) -> None:
    with pytest.raises(UsageError, match="expected http://HOST:PORT/PATH") as caught:
        HttpModel(parse(spec))
    assert "pass@" not in str(caught.value)


@pytest.fixture
def predictor(servant: Servant) -> dict[str, Any]:
    """What a server of the other contract can do; its frames count 0, 10, 20, ..."""
    can: dict[str, Any] = {"model": "tiny"}

    def predict(asked: Asked) -> Reply:
        width, height = asked.body["size"]
        pictures = (np.full((height, width, 3), 10 * i, np.uint8) for i in range(asked.body["num_frames"]))
        return Reply({"frames": [base64_png(picture) for picture in pictures]})

    servant.routes |= {
        "/v1/health": [Reply({"status": "ok"})],
        "/v1/capabilities": lambda asked: Reply(can),
        "/v1/predict": predict,
    }
    return can


@pytest.mark.parametrize("path", ["", "/", "/v1/predict", "?style=predict"])
def test_the_predict_protocol_generates_a_video_and_checks_health_once(
    predictor: dict[str, Any], servant: Servant, hurried: Limits, request_: Request, out: Path, path: str
) -> None:
    model = HttpModel(parse(f"http:{servant.url}{path}"), hurried)
    model.generate(request_, out)
    video = model.generate(request_, out)
    frames = decoded(video)[1]
    assert frames.shape == (5, 64, 96, 3)
    assert np.abs(frames.mean((1, 2, 3)) - 10 * np.arange(5)).max() < 3
    assert len(servant.at("/v1/health")) == 1
    assert len(servant.at("/v1/predict")) == 2
    assert list(out.parent.iterdir()) == [video]


def test_predict_stays_within_the_capabilities_of_the_server(
    predictor: dict[str, Any],
    servant: Servant,
    hurried: Limits,
    request_: Request,
    actions: ActionTrack,
    out: Path,
) -> None:
    predictor.update(max_num_frames=3, size=[32, 48])
    model = HttpModel(parse(servant.url), hurried)
    frames = decoded(model.generate(replace(request_, actions=actions), out))[1]
    assert frames.shape == (3, 48, 32, 3)
    (asked,) = servant.at("/v1/predict")
    assert asked.body["actions"] == {name: values[:3] for name, values in actions.to_json().items()}
    (picture,) = asked.body["frames"]
    assert Image.open(io.BytesIO(base64.b64decode(picture))).size == (32, 48)


@pytest.mark.parametrize("head", ["", "data:image/png;base64,"])
def test_base64_with_line_breaks_is_accepted(
    predictor: dict[str, Any],
    servant: Servant,
    hurried: Limits,
    request_: Request,
    out: Path,
    head: str,
    ask: Callable[..., Path],
    film: bytes,
) -> None:
    picture = np.random.default_rng(0).integers(256, size=(8, 16, 3), dtype=np.uint8)
    text = head + base64.encodebytes(png(picture)).decode()
    assert "\n" in text.strip()
    servant.routes["/v1/predict"] = [Reply({"frames": [text] * 3})]
    frames = decoded(HttpModel(parse(servant.url), hurried).generate(request_, out))[1]
    assert frames.shape == (3, 8, 16, 3)
    assert ask({"video_base64": head + base64.encodebytes(film).decode()}).read_bytes() == film


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (None, "has no frames"),
        ([], "has no frames"),
        ([1], "has no frames"),
        (["%%"], "frame 0 is not a PNG file in base64"),
        ([base64_of(b"GIF89a")], "frame 0 is not a PNG"),
        ([base64_png(np.zeros((2, 2, 3), np.uint8))[:40]], "frame 0 is not a PNG"),
        ([base64_png(np.zeros((2, n, 3), np.uint8)) for n in (2, 3)], "different sizes"),
        ([base64_png(np.zeros((2, 2, 3), np.uint8))] * 6, "answered with 6 frames, 5 were requested"),
        (
            [base64_of(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\0\0\x40\0" * 2 + b"\x08\2\0\0\0\0\0\0\0")],
            "frame 0 .* PNG|too many",
        ),
    ],
)
def test_unusable_predictions_are_refused(
    predictor: dict[str, Any],
    servant: Servant,
    hurried: Limits,
    request_: Request,
    out: Path,
    frames: Any,
    message: str,
) -> None:
    servant.routes["/v1/predict"] = [Reply({"frames": frames})]
    with pytest.raises(WorldModelError, match=message):
        HttpModel(parse(servant.url), hurried).generate(request_, out)
    assert list(out.parent.iterdir()) == []


def test_an_unready_server_and_malformed_capabilities_are_setup_errors(
    predictor: dict[str, Any], servant: Servant, hurried: Limits, request_: Request, out: Path
) -> None:
    predictor["max_num_frames"] = "many"
    with pytest.raises(SetupError, match="capabilities: max_num_frames"):
        HttpModel(parse(servant.url), hurried).generate(request_, out)
    servant.routes["/v1/health"] = [Reply({"status": "loading"})]
    with pytest.raises(SetupError, match="its health is 'loading'"):
        HttpModel(parse(servant.url), hurried).generate(request_, out)
    servant.routes["/v1/capabilities"] = [Reply(status=500)]
    with pytest.raises(WorldModelError, match="HTTP 500"):  # it is not taken for a server of the simple contract
        HttpModel(parse(servant.url), hurried).generate(request_, out)


def test_frames_beside_an_error_are_not_used(
    predictor: dict[str, Any], servant: Servant, hurried: Limits, request_: Request, out: Path
) -> None:
    frames = [base64_png(np.zeros((64, 96, 3), np.uint8))] * 2
    servant.routes["/v1/predict"] = [Reply({"frames": frames, "error": "out of memory"})]
    with pytest.raises(WorldModelError, match="gave no frames: out of memory"):
        HttpModel(parse(servant.url), hurried).generate(request_, out)


def test_decoding_counts_towards_the_timeout(
    servant: Servant, hurried: Limits, request_: Request, film: bytes, monkeypatch: pytest.MonkeyPatch, out: Path
) -> None:
    def slow(text: str) -> bytes:
        time.sleep(1.0)
        return from_base64(text)

    monkeypatch.setattr(http, "from_base64", slow)
    servant.routes["/make"] = [Reply({"video_base64": base64_of(film)})]
    with pytest.raises(WorldModelError, match=r"no video within 1 s"):
        HttpModel(parse(f"{servant.url}/make?timeout=1"), hurried).generate(request_, out)
    assert list(out.parent.iterdir()) == []
