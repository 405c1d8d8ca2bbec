import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.io.container import write_video
from kinebench_drake.suites.worldmodels.remote import Limits
from kinebench_drake.suites.worldmodels.worldmodel import ActionTrack, Request
from tests.suites.worldmodels.servant import Servant

KEY = "sk-very-secret-0123456789"


@pytest.fixture
def request_() -> Request:
    frame = np.zeros((64, 96, 3), np.uint8)
    frame[:, :48] = (200, 40, 40)
    return Request(
        episode="StackCube-v1_s0003",
        task="StackCube-v1",
        round=0,
        prompt='stack "it"; $(touch x)',
        negative_prompt="blur",
        seed=2**31 + 7,
        first_frame=frame,
        num_frames=5,
        fps=17.0,
    )


@pytest.fixture
def actions() -> ActionTrack:
    """Actions of a robot that waits."""
    X_BG = np.tile(np.eye(4), (5, 1, 1))
    return ActionTrack(t_s=0.2 * np.arange(5), X_BG=X_BG, finger_width_m=np.full(5, 0.08), q=np.ones((5, 7)))


@pytest.fixture(scope="session")
def film(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    write_video(path, [np.full((64, 96, 3), 40 * i, np.uint8) for i in range(5)], 17)
    return path.read_bytes()


@pytest.fixture(scope="session")
def gif() -> bytes:
    frames = [Image.new("RGB", (32, 32), (40 * i, 0, 0)) for i in range(3)]
    frames[0].save(buffer := io.BytesIO(), format="gif", save_all=True, append_images=frames[1:])
    return buffer.getvalue()


@pytest.fixture
def servant() -> Iterator[Servant]:
    made = Servant()
    yield made
    made.stop()


@pytest.fixture
def hurried() -> Limits:
    """Limits of one who cannot wait."""
    return Limits(
        attempts=3,
        first_wait_s=0.002,
        longest_wait_s=0.01,
        silence_s=5.0,
        poll_s=0.002,
        json_bytes=4096,
        video_bytes=20_000,
    )


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> str:
    """The key of every service; a proxy that nobody may ask."""
    for name in ("DASHSCOPE_API_KEY", "MINIMAX_API_KEY", "MY_API_KEY"):
        monkeypatch.setenv(name, KEY)
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "https_proxy", "all_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    monkeypatch.delenv("NO_PROXY", raising=False)
    monkeypatch.delenv("no_proxy", raising=False)
    return KEY


@pytest.fixture
def out(tmp_path: Path) -> Path:
    folder = tmp_path / "out"
    folder.mkdir()
    return folder / "StackCube-v1_s0003_r0"
