import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.errors import InputError, UsageError
from kinebench_drake.io.container import write_video
from kinebench_drake.io.files import VIDEO_SUFFIXES
from kinebench_drake.suites.worldmodels.factory import FORMS, create
from kinebench_drake.suites.worldmodels.media import DEMUXERS, suffix_of
from kinebench_drake.suites.worldmodels.spec import Spec, parse
from kinebench_drake.suites.worldmodels.worldmodel import Request, request_video
from tests.films import decoded


def test_still_repeats_the_first_frame(request_: Request, out: Path) -> None:
    path = create("still").generate(request_, out)
    times, frames = decoded(path)
    assert len(times) == request_.num_frames
    assert times[1] == pytest.approx(1 / request_.fps, rel=1e-3)
    assert np.abs(frames.astype(int) - request_.first_frame).mean() < 4
    assert list(out.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("still?name=baseline", "baseline"),
        ("http://localhost:8000/generate", "localhost:8000/generate"),
        ("http://localhost:8000/v1/predict", "localhost:8000"),
        ("https://example.org/?name=wan", "wan"),
        ("https://localhost/x?style=simple&name=a%26b%20c", "a&b c"),
        ("http:http://localhost", "localhost"),
        ("command:true {prompt}", "true"),
        ("dashscope", "wan2.6-i2v"),
        ("minimax:MiniMax-Hailuo-2.3", "MiniMax-Hailuo-2.3"),
        ("oracle", "oracle"),
        ("oracle?true_track=true", "oracle, true track"),
        ("oracle?delay=2", "oracle, 2 frames late"),
        ("random?name=walk", "walk"),
    ],
)
def test_a_spec_determines_the_name_of_the_model(text: str, name: str, keys: str) -> None:
    model = create(text)
    assert model.name == name
    model.close()


def test_errors_of_specs_name_every_adapter_and_its_options(tmp_path: Path, keys: str) -> None:
    """Wrong forms list every right one; every kind says of a wrong option which ones there are."""
    for text in ("", "floder", "oracle+", "a b:c"):
        with pytest.raises(UsageError) as caught:
            create(text)
        assert all(form.usage in str(caught.value) for form in FORMS.values())
        assert "module:Class" in str(caught.value)
    rests = {
        "folder": str(tmp_path),
        "http": "//localhost",
        "https": "//localhost",
        "command": "true",
        "diffusers": "x",
    }
    for kind in FORMS:
        with pytest.raises(UsageError, match="zzz is not an option; options are name"):
            create(f"{kind}:{rests.get(kind, '')}?zzz=1")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("still?name=", r"name= must be 1 to 80 characters without / or \\"),
        ("still?name=a/b", r"name=a/b must be 1 to 80 characters without / or \\"),
        ("still?name=a&name=b", "name is given twice"),
        ("http://h?key_env=a-b", "key_env=a-b must be the environment variable"),
        ("still?nam=x", r"nam is not an option \(did you mean name\?\)"),
        ("oracel", r"no world model 'oracel' \(did you mean oracle\?\)"),
        ("still:x", "expected still by itself, found 'x'"),
        ("command:true?timeout=nan", "timeout=nan"),
        ("dashscope:?duration=many", "duration=many: Input should be a valid integer"),
        ("minimax:?resolution=4K", "resolution=4K: Input should be '512P', '768P' or '1080P'"),
        ("folder:/nonexistent", "expected folder:DIR"),
    ],
)
def test_unusable_specs_are_usage_errors(text: str, message: str, keys: str) -> None:
    with pytest.raises(UsageError, match=f"world_model .*{message}"):
        create(text)


def test_options_are_decoded_once() -> None:
    assert parse("a:b?c=d%3Fe%2525=f").options == {"c": "d?e%25=f"}
    assert parse("a:b?c=").options == {"c": ""}
    assert parse("a:b?c") == Spec(text="a:b?c", kind="a", rest="b?c", options={})


class Model:
    def __init__(self, level: str = "1") -> None:
        self.name = f"mine{level}" if int(level) else None + level

    def generate(self, request: Request, out: Path) -> Path:
        return out

    def close(self) -> None:
        pass


class Nameless(Model):
    def __init__(self) -> None:
        pass


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> None:
    made = ModuleType("my_models")
    made.Model = Model
    made.Nameless = Nameless
    made.Path = Path
    monkeypatch.setitem(sys.modules, "my_models", made)


@pytest.mark.usefixtures("module")
def test_a_plugin_class_is_created_with_its_options_or_refused() -> None:
    assert create("my_models:Model").name == "mine1"
    assert create("my_models:Model?level=9").name == "mine9"
    for text, message in {
        "my_models:Model?depth=9": "does not take these options",
        "my_models:Model?level=0": r"its __init__ raised TypeError: .*\(test_factory.py, line \d+\)",
        "my_models:Nameless": "expected a class whose instances have a name",
        "my_models:Path": r"a class with a method generate\(request, out\).*; world models are named folder:DIR",
        "my_models:None_": "the module my_models has no None_.*; world models are named folder:DIR",
        "floder:x": r"there is no module 'floder'.*\(did you mean folder\?\); world models are named folder:DIR",
    }.items():
        with pytest.raises(UsageError, match=message):
            create(text)


def test_a_plugin_class_may_be_named_by_its_file(tmp_path: Path) -> None:
    file = tmp_path / "my-model.py"
    file.write_text(
        "class M:\n    name = 'mine'\n    def generate(self, request, out): ...\n    def close(self): ...\n"
    )
    assert create(f"{file}:M").name == "mine"


def _raise() -> None:
    raise ValueError("out of\nmemory")


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda: None, "returned a NoneType that is no file, expected the path of the video"),
        (lambda: np.zeros((5, 64, 96, 3)), "returned a ndarray that is no file, expected the path"),
        (lambda: "nowhere/x.mp4", "returned a str that is no file, expected the path"),
        (_raise, r"raised ValueError: out of; its traceback is in videos/a_r0_error\.txt"),
    ],
)
def test_an_answer_that_is_no_video_says_what_generate_must_return(
    tmp_path: Path, request_: Request, answer: Callable[[], object], message: str
) -> None:
    out = tmp_path / "videos" / "a_r0"
    out.parent.mkdir()
    model = SimpleNamespace(generate=lambda request, out: answer())
    with pytest.raises(InputError, match=message):
        request_video(model, request_, out)
    for trace in out.parent.iterdir():
        text = trace.read_text()
        assert 'File "test_factory.py", line' in text
        assert "raise ValueError" in text
        assert str(Path(__file__).parent) not in text


def test_frames_of_another_shape_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a frame has shape \(3, 64, 96\) and type float64, expected \(H, W, 3\)"):
        write_video(tmp_path / "x.mp4", np.zeros((2, 3, 64, 96)), 17)
    assert not list(tmp_path.iterdir())


def test_every_video_suffix_has_a_demuxer() -> None:
    assert set(DEMUXERS) == VIDEO_SUFFIXES


def test_the_first_bytes_of_a_video_determine_its_format(film: bytes, gif: bytes) -> None:
    assert suffix_of(film) == ".mp4"
    assert suffix_of(gif) == ".gif"
    assert suffix_of(b"\0\0\0\x14ftypqt  ") == ".mov"
    assert suffix_of(b"RIFF\0\0\0\0AVI LIST") == ".avi"
    assert suffix_of(b"\x1a\x45\xdf\xa3\x01\0\0\0\0\0\0\x1f\x42\x82\x84webm") == ".webm"
    assert suffix_of(b"\x1a\x45\xdf\xa3" + b"matroska") == ".mkv"
    assert suffix_of(b"RIFF\0\0\0\0WAVE") is None
    assert suffix_of(b"") is None
