"""The contract "simple" of a world model behind HTTP."""

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
from kinebench_drake.suites.worldmodels import http, http_client
from kinebench_drake.suites.worldmodels.http import HttpModel
from kinebench_drake.suites.worldmodels.media import from_base64
from kinebench_drake.suites.worldmodels.remote import Limits
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request, WorldModelError
from tests.suites.worldmodels.servant import Reply, Servant


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
        "target_frames": 5,
        "size": [96, 64],
        "output_size": [96, 64],
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
        *({key: str(tmp_path / "made.bin")} for key in ("path", "output_path")),
        {"url": f"{servant.url}/v"},
        {"video": base64_of(film)},
        {"video": base64.encodebytes(film).decode()},  # with line breaks
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
        ({"video_base64": ""}, "not a video"),
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
    ask: Callable[..., Path], servant: Servant, hurried: Limits, request_: Request, tmp_path: Path, out: Path
) -> None:
    large = tmp_path / "sparse.mp4"
    with large.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(WorldModelError, match=r"more than 0\.019\S* MiB of video"):
        ask({"video_path": str(large)})
    unbounded = replace(hurried, video_bytes=2**41)
    with pytest.raises(WorldModelError, match=r"no video within 0\.5 s"):
        HttpModel(parse(f"{servant.url}/make?timeout=0.5"), unbounded).generate(request_, out)
    assert list(out.parent.iterdir()) == []


def test_a_video_path_is_accepted_only_from_this_machine(hurried: Limits, tmp_path: Path, film: bytes) -> None:
    (tmp_path / "v.mp4").write_bytes(film)
    model = HttpModel(parse("https://example.org/make"), hurried)
    with pytest.raises(WorldModelError, match="only from a server on this machine"):
        model.fetch({"video_path": str(tmp_path / "v.mp4")}, tmp_path / "part", None)  # no server there to ask


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


def test_decoding_counts_towards_the_timeout(
    servant: Servant, hurried: Limits, request_: Request, film: bytes, monkeypatch: pytest.MonkeyPatch, out: Path
) -> None:
    def slow(text: str) -> bytes:
        start_s = time.monotonic()
        monkeypatch.setattr(http_client.time, "monotonic", lambda: start_s + 60.0)
        return from_base64(text)

    monkeypatch.setattr(http, "from_base64", slow)
    servant.routes["/make"] = [Reply({"video_base64": base64_of(film)})]
    with pytest.raises(WorldModelError, match=r"no video within 30 s"):
        HttpModel(parse(f"{servant.url}/make?timeout=30"), hurried).generate(request_, out)
    assert list(out.parent.iterdir()) == []
