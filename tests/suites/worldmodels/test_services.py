"""DashScope and MiniMax against a server that speaks their protocols, their errors included."""

import base64
import io
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.suites.worldmodels.cloud import DashScopeModel, MiniMaxModel
from kinebench_drake.suites.worldmodels.remote import Limits
from kinebench_drake.suites.worldmodels.spec import parse
from kinebench_drake.suites.worldmodels.worldmodel import Request, WorldModelError
from tests.suites.worldmodels.servant import Reply, Servant

SUBMIT = "/api/v1/services/aigc/video-generation/video-synthesis"
TASK = "/api/v1/tasks/t%2F1"
"""Where the state of task "t/1" is found."""


@pytest.fixture
def dashscope(servant: Servant, hurried: Limits, keys: str, film: bytes) -> DashScopeModel:
    def state(status: str, **more: str) -> Reply:
        return Reply({"output": {"task_id": "t/1", "task_status": status, **more}})

    servant.routes[SUBMIT] = [state("PENDING")]
    servant.routes[TASK] = [
        state("PENDING"),
        state("RUNNING"),
        state("SUCCEEDED", video_url=f"{servant.url}/v.mp4?sig=1"),
    ]
    servant.routes["/v.mp4"] = [Reply(film)]
    return DashScopeModel(parse(f"dashscope:?base={servant.url}&timeout=20&duration=4"), hurried)


@pytest.fixture
def minimax(servant: Servant, hurried: Limits, keys: str, film: bytes) -> MiniMaxModel:
    fine = {"base_resp": {"status_code": 0, "status_msg": "success"}}
    servant.routes["/v1/video_generation"] = [Reply({"task_id": "t1", **fine})]
    servant.routes["/v1/query/video_generation"] = [
        *(Reply({"status": status, "file_id": "", **fine}) for status in ("Preparing", "Queueing", "Processing")),
        Reply({"status": "Success", "file_id": "77", **fine}),
    ]
    servant.routes["/v1/files/retrieve"] = [Reply({"file": {"download_url": f"{servant.url}/v.mp4"}, **fine})]
    servant.routes["/v.mp4"] = [Reply(film)]
    return MiniMaxModel(parse(f"minimax:?base={servant.url}&timeout=20"), hurried)


def refusal(code: int, message: str = "no") -> Reply:
    return Reply({"base_resp": {"status_code": code, "status_msg": message}})


def shown(uri: str) -> np.ndarray:
    """The picture of a data URI."""
    head, _, data = uri.partition(",")
    assert head == "data:image/png;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_dashscope_submits_polls_and_downloads_the_video(
    dashscope: DashScopeModel, servant: Servant, request_: Request, out: Path, film: bytes, keys: str
) -> None:
    path = dashscope.generate(request_, out)
    assert (path, path.read_bytes()) == (out.with_name(f"{out.name}.mp4"), film)
    assert list(out.parent.iterdir()) == [path]
    (submit,) = servant.at(SUBMIT)
    assert submit.headers["X-DashScope-Async"] == "enable"
    assert submit.headers["Authorization"] == f"Bearer {keys}"
    assert submit.body["model"] == dashscope.name == "wan2.6-i2v"
    assert submit.body["input"]["prompt"] == request_.prompt
    assert submit.body["input"]["negative_prompt"] == "blur"
    assert np.array_equal(shown(submit.body["input"]["img_url"]), request_.first_frame)
    parameters = submit.body["parameters"]
    assert (parameters["seed"], parameters["duration"], parameters["prompt_extend"]) == (7, 4, False)
    assert len(servant.at(TASK)) == 3


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ({"task_status": "FAILED", "code": "InternalError", "message": "GPU\nlost"}, "FAILED: InternalError GPU lost"),
        ({"task_status": "FAILED", "code": "DataInspectionFailed", "message": "bad"}, r"moderation refused .*\(bad\)"),
        ({"task_status": "CANCELED"}, "CANCELED"),
        ({"task_status": "UNKNOWN"}, "UNKNOWN"),
        ({"task_status": "SUCCEEDED"}, "no reason given"),
        ({}, "None"),
    ],
)
def test_failed_dashscope_tasks_are_reported_with_code_and_message(
    dashscope: DashScopeModel, servant: Servant, request_: Request, out: Path, output: dict[str, str], message: str
) -> None:
    servant.routes[TASK] = [Reply({"output": output})]
    with pytest.raises(WorldModelError, match=message):
        dashscope.generate(request_, out)
    assert list(out.parent.iterdir()) == []


def test_dashscope_moderation_is_a_model_error_and_accounts_are_setup_errors(
    dashscope: DashScopeModel, servant: Servant, request_: Request, out: Path
) -> None:
    servant.routes[SUBMIT] = [
        Reply({"code": "DataInspectionFailed", "message": "bad words"}, status=400),
        Reply({"code": "InvalidApiKey", "message": "no"}, status=401),
        Reply({"code": "Arrearage", "message": "overdue"}, status=400),
        Reply({"output": {}}),
    ]
    with pytest.raises(WorldModelError, match=r"moderation refused the request or the video .*bad words"):
        dashscope.generate(request_, out)
    with pytest.raises(SetupError, match="InvalidApiKey"):
        dashscope.generate(request_, out)
    with pytest.raises(SetupError, match=r"overdue.*account"):
        dashscope.generate(request_, out)
    with pytest.raises(WorldModelError, match="gave no task_id"):
        dashscope.generate(request_, out)


def test_dashscope_retries_after_rate_limits(
    dashscope: DashScopeModel, servant: Servant, request_: Request, out: Path
) -> None:
    servant.routes[SUBMIT].insert(0, Reply(status=429, headers={"Retry-After": "0"}))
    servant.routes[TASK].insert(1, Reply(status=503))
    assert dashscope.generate(request_, out).is_file()


@pytest.mark.parametrize("status", [500, 502, 503, 504])
def test_a_submission_that_may_have_cost_is_not_repeated(
    dashscope: DashScopeModel, minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path, status: int
) -> None:
    for model, path in ((dashscope, SUBMIT), (minimax, "/v1/video_generation")):
        servant.routes[path].insert(0, Reply(status=status, headers={"Retry-After": "0"}))
        with pytest.raises(WorldModelError, match=f"answered HTTP {status}"):
            model.generate(request_, out)
        assert len(servant.at(path)) == 1


def test_an_endless_task_runs_into_the_timeout(
    servant: Servant, hurried: Limits, keys: str, request_: Request, out: Path
) -> None:
    servant.routes[SUBMIT] = [Reply({"output": {"task_id": "t"}})]
    servant.routes["/api/v1/tasks/t"] = [Reply({"output": {"task_status": "RUNNING"}})]
    with pytest.raises(WorldModelError, match=r"no video within 0\.2 s"):
        DashScopeModel(parse(f"dashscope:?base={servant.url}&timeout=0.2"), hurried).generate(request_, out)
    assert len(servant.at(SUBMIT)) <= 1


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "not a video"),
        (b"<html>gone</html>", "not a video"),
        (b"\0\0\0\x18ftypisom" + b"\0" * 99, "damaged"),
        (b"#EXTM3U\nhttp://127.0.0.1/x", "not a video"),
        (b"v" * 30_000, "more than"),
    ],
)
def test_a_download_other_than_a_video_is_refused(
    dashscope: DashScopeModel, servant: Servant, request_: Request, out: Path, data: bytes, message: str
) -> None:
    servant.routes["/v.mp4"] = [Reply(data)]
    with pytest.raises(WorldModelError, match=message):
        dashscope.generate(request_, out)
    assert list(out.parent.iterdir()) == []


def test_the_suffix_of_a_download_follows_its_contents(
    dashscope: DashScopeModel, servant: Servant, request_: Request, out: Path, gif: bytes
) -> None:
    servant.routes["/v.mp4"] = [Reply(gif)]
    assert dashscope.generate(request_, out).suffix == ".gif"


def test_minimax_submits_polls_and_downloads_the_video(
    minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path, film: bytes, keys: str
) -> None:
    assert minimax.generate(request_, out).read_bytes() == film
    (submit,) = servant.at("/v1/video_generation")
    assert submit.headers["Authorization"] == f"Bearer {keys}"
    picture = submit.body.pop("first_frame_image")
    assert np.array_equal(shown(picture), request_.first_frame)
    assert submit.body == {
        "model": "MiniMax-Hailuo-02",
        "prompt": request_.prompt,
        "duration": 6,
        "resolution": "768P",
        "prompt_optimizer": False,
    }
    assert {asked.path for asked in servant.at("/v1/query/video_generation")} == {
        "/v1/query/video_generation?task_id=t1"
    }
    assert [asked.path for asked in servant.at("/v1/files/retrieve")] == ["/v1/files/retrieve?file_id=77"]


@pytest.mark.parametrize("code", [1004, 1008, 2049])
def test_minimax_account_errors_are_setup_errors_with_masked_key(
    minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path, code: int, keys: str
) -> None:
    servant.routes["/v1/video_generation"] = [refusal(code, f"bad {keys}")]
    with pytest.raises(SetupError, match=rf"{code}: bad \*\*\*; look at MINIMAX_API_KEY"):
        minimax.generate(request_, out)


def test_minimax_refusals_are_reported_and_not_retried(
    minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path
) -> None:
    servant.routes["/v1/video_generation"] = [refusal(1026), refusal(2013, "invalid params")]
    with pytest.raises(WorldModelError, match="moderation"):
        minimax.generate(request_, out)
    with pytest.raises(WorldModelError, match="2013: invalid params"):
        minimax.generate(request_, out)
    assert len(servant.asked) == 2


def test_minimax_reports_moderation_and_failure_of_its_video(
    minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path
) -> None:
    servant.routes["/v1/query/video_generation"] = [
        Reply({"status": "Fail", "base_resp": {"status_code": 1027, "status_msg": "x"}}),
        Reply({"status": "Fail", "base_resp": {"status_code": 0, "status_msg": "lost"}}),
    ]
    with pytest.raises(WorldModelError, match="moderation"):
        minimax.generate(request_, out)
    with pytest.raises(WorldModelError, match="ended as Fail: lost"):
        minimax.generate(request_, out)


def test_minimax_rate_limits_with_http_200_are_retried(
    minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path
) -> None:
    """A rate limit comes with HTTP status 200. Other troubles are not tried again where it might cost."""
    submit = servant.routes["/v1/video_generation"]
    servant.routes["/v1/video_generation"] = [refusal(1002), *submit]
    servant.routes["/v1/query/video_generation"].insert(0, refusal(1001))
    assert minimax.generate(request_, out).is_file()
    servant.routes["/v1/video_generation"] = [refusal(1000)]
    count = len(servant.asked)
    with pytest.raises(WorldModelError, match="1000"):
        minimax.generate(request_, out)
    assert len(servant.asked) == count + 1


def test_minimax_without_a_download_url_is_an_error(
    minimax: MiniMaxModel, servant: Servant, request_: Request, out: Path
) -> None:
    servant.routes["/v1/files/retrieve"] = [Reply({"file": {}})]
    with pytest.raises(WorldModelError, match="no download_url"):
        minimax.generate(request_, out)


@pytest.mark.parametrize(("kind", "make"), [("dashscope", DashScopeModel), ("minimax", MiniMaxModel)])
def test_services_refuse_missing_keys_and_unusable_addresses(
    kind: str, make: type[DashScopeModel] | type[MiniMaxModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    variable = f"{kind.upper()}_API_KEY"
    for bad in (None, "", "  ", "a\nb", "clé"):
        monkeypatch.delenv(variable, raising=False)
        if bad is not None:
            monkeypatch.setenv(variable, bad)
        with pytest.raises(SetupError, match=f"{variable} (is not set|holds signs)"):
            make(parse(f"{kind}:"))
    monkeypatch.setenv(variable, "sk-of-another-account")
    assert make(parse(f"{kind}:some-model")).name == "some-model"
    with pytest.raises(SetupError, match="only over https"):
        make(parse(f"{kind}:?base=http://example.org"))
    with pytest.raises(UsageError, match=re.escape("base= expected")):
        make(parse(f"{kind}:?base=file:///x"))
    with pytest.raises(UsageError, match="sise is not an option; options are name, timeout, resolution, duration"):
        make(parse(f"{kind}:?sise=1"))
