"""The Python interface beside the commands: the same arguments, the same numbers."""

import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import kinebench_drake
from kinebench_drake import audit_trajectory, ground_video, run_suite, score_videos
from kinebench_drake.api import single
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.cli import cli
from kinebench_drake.errors import InputError, KinebenchError, UnmeasurableError, UsageError
from kinebench_drake.formats.camerafile import save_camera
from kinebench_drake.geometry import make_pose
from kinebench_drake.io.reader import read_video
from kinebench_drake.results.record import to_json
from kinebench_drake.results.row import Status
from kinebench_drake.results.store import read_rows
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs import score
from kinebench_drake.runs.config import ScoreConfig
from kinebench_drake.runs.option import options_of
from kinebench_drake.suites.runs import episodes
from kinebench_drake.suites.runs.suite_config import SuiteConfig
from kinebench_drake.track import InitialState
from tests.fakes.records import content
from tests.fakes.resources import FakeResources

NOISE = np.random.default_rng(0).integers(0, 255, (4, 96, 200, 3), np.uint8)
EXAMPLES = Path(__file__).parents[2] / "examples" / "videos"


@pytest.fixture
def quick(monkeypatch, fakes):
    """Single samples are worked on by the fake analyzer, too."""
    monkeypatch.setattr(single, "make_resources", FakeResources)
    single.cached_resources.cache_clear()  # another test may have loaded the real one
    yield
    single.cached_resources.cache_clear()


def command(*names):
    found = cli
    for name in names:
        found = found.get_command(None, name)
    return {param.name: param for param in found.params}


@pytest.mark.parametrize(
    ("names", "function", "config"),
    [(("score",), score_videos, ScoreConfig), (("suite", "run"), run_suite, SuiteConfig)],
)
def test_every_command_line_option_is_a_keyword_argument_of_the_function(names, function, config):
    arguments = dict(inspect.signature(function).parameters)
    assert arguments.pop("options").kind is inspect.Parameter.VAR_KEYWORD
    assert arguments.pop("observer").default is None
    assert arguments.keys() <= options_of(config).keys()
    assert options_of(config).keys() - command(*names).keys() <= {"table_height_m", "format"}
    first, *others = arguments.values()
    assert first.kind is inspect.Parameter.POSITIONAL_OR_KEYWORD
    assert all(argument.kind is inspect.Parameter.KEYWORD_ONLY for argument in others)


def test_function_defaults_equal_command_defaults(program, monkeypatch, tmp_path):
    """A run of the interface with no options has the configuration of the command with none."""
    configs = []

    def record(config, observer):
        configs.append(config)
        raise UsageError("seen")

    monkeypatch.setattr(score, "score_videos", record)
    monkeypatch.setattr(episodes, "run_suite", record)
    for call in (
        lambda: score_videos(tmp_path, out=tmp_path / "out"),
        lambda: run_suite(0, world_model="still", out=tmp_path / "out"),
    ):
        with pytest.raises(UsageError, match="seen"):
            call()
    program("score", tmp_path, "--out", tmp_path / "out")
    program("suite", "run", "--suite", "0", "--world-model", "still", "--out", tmp_path / "out")
    assert configs[:2] == configs[2:]


def test_ground_video_and_audit_trajectory_take_the_options_of_single_samples():
    for name, function in (("ground", ground_video), ("audit", audit_trajectory)):
        _, text = function.__doc__.split("**options: ")
        options = set(re.findall(r"`([a-z_]+)`", text.split("\n\n")[0]))
        assert len(options) >= 8
        assert options <= command(name).keys()
    with pytest.raises(UsageError, match="jobs, tags: has no effect with one sample"):
        audit_trajectory(np.zeros((4, 7)), rate_hz=10, tags={"a": "b"}, jobs=2)
    with pytest.raises(TypeError, match="hertz"):
        audit_trajectory(np.zeros((4, 7)), hertz=10)


def test_package_exports_every_function_and_rejects_unknown_attributes():
    assert all(callable(getattr(kinebench_drake, name)) for name in kinebench_drake.__all__ if name != "__version__")
    with pytest.raises(AttributeError, match="conjure"):
        _ = kinebench_drake.conjure


def test_score_videos_writes_the_same_files_as_the_score_command(program, film, tmp_path):
    film("videos/a.mp4")
    film("videos/b.mp4", feasible=False)
    film("videos/c.mp4", has_gripper=False)
    options = ("--tag", "x=1", "--frame-period", "0.1", "--table-height", "0.01", "--model", "m")
    assert program("score", tmp_path / "videos", "--out", tmp_path / "command", *options)[0] == 0
    summary = score_videos(
        tmp_path / "videos", out=tmp_path / "api", tags={"x": "1"}, frame_period_s=0.1, table_height_m=0.01, model="m"
    )
    assert content(tmp_path / "api") == content(tmp_path / "command")
    assert summary.counts == {Status.OK: 2, Status.UNMEASURABLE: 1, Status.ERROR: 0}
    assert {row.id: row.feasible for row in summary.rows} == {"a": True, "b": False, "c": None}


@pytest.mark.usefixtures("quick")
def test_ground_video_returns_the_track_that_the_ground_command_writes(program, film, tmp_path):
    path = film("videos/clip.mp4", side=128)
    film("videos/other.mp4", side=128)
    save_camera(benchmark_camera().resized(256, 256), tmp_path / "videos" / "camera.json")
    assert program("ground", tmp_path / "videos", "--out", tmp_path / "out")[0] == 0
    written = read_track(tmp_path / "out" / "tracks" / "clip.npz").track
    frames = read_video(path).frames
    for grounded in (
        ground_video(path),
        ground_video(tmp_path / "videos", id="clip"),
        ground_video(frames, frame_period_s=1 / 17, camera=tmp_path / "videos" / "camera.json"),
        ground_video(frames, frame_period_s=1 / 17, camera=benchmark_camera()),
    ):
        for name in ("t_s", "X_CH", "X_BG", "tracked", "confidence", "finger_width_m"):
            np.testing.assert_array_equal(getattr(grounded.track, name), getattr(written, name))


@pytest.mark.usefixtures("quick")
def test_a_camera_contradicted_by_the_arm_raises_a_warning(film):
    with pytest.warns(UserWarning, match="1.43 times as long"):
        ground_video(film("clip.mp4", choice={"reason": "1.43 times as long"}), camera=benchmark_camera())


@pytest.mark.usefixtures("quick")
def test_ground_video_starts_from_the_first_pose_passed_to_it(film, tmp_path):
    X_BG = make_pose(np.eye(3), [0.5, 0.1, 0.2])
    track = ground_video(film("clip.mp4"), first=InitialState(X_BG=X_BG)).track
    np.testing.assert_array_equal(track.X_BG[0], X_BG)


@pytest.mark.usefixtures("quick")
def test_audit_trajectory_returns_the_metrics_that_the_audit_command_writes(program, tmp_path):
    t_s = 0.1 * np.arange(8)
    q = np.linspace(0.0, 0.4, 8)[:, None] * np.ones(7)
    np.savez(tmp_path / "move.npz", t_s=t_s, q=q)
    assert program("audit", tmp_path / "move.npz", "--out", tmp_path / "out")[0] == 0
    row = read_rows(tmp_path / "out")["move"]
    for judged in (
        audit_trajectory(q, t_s=t_s),
        audit_trajectory(tmp_path / "move.npz"),
        audit_trajectory(q, rate_hz=10),
    ):
        assert judged.feasible is row.feasible is True
        assert all(row.metrics[name] == to_json(value) for name, value in judged.metrics.items())
        np.testing.assert_array_equal(judged.joints.q, q)
    with pytest.warns(UserWarning, match="8 columns"):
        audit_trajectory(np.hstack([q, q[:, :1]]), t_s=t_s)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("call", "error", "told"),
    [
        (lambda at: ground_video(at / "nowhere.mp4"), UsageError, "no such file"),
        (lambda at: ground_video(at / "videos"), UsageError, "holds 2 samples, expected one; .* id='a'"),
        (lambda at: ground_video(at / "videos", id="aa"), UsageError, "no sample 'aa'"),
        (lambda at: ground_video(at / "videos" / "a.mp4", frame_period_s=0.0), UsageError, "0.0001 to 1000"),
        (lambda at: ground_video(np.zeros((4, 96, 96, 3))), InputError, "expected uint8"),
        (lambda at: ground_video(np.zeros((1, 96, 96, 3), np.uint8)), UnmeasurableError, "at least 2"),
        (lambda at: ground_video(NOISE, frame_period_s=1.0, camera=benchmark_camera()), UnmeasurableError, "aspect"),
        (lambda at: ground_video(np.zeros((4, 96, 96, 3), np.uint8), camera_key="front"), UsageError, "camera_key"),
        (lambda at: audit_trajectory(np.zeros((4, 7))), InputError, "no times"),
        (lambda at: audit_trajectory(np.zeros(7), rate_hz=10), InputError, r"shape \(7,\)"),
        (lambda at: audit_trajectory(np.full((4, 7), 90.0), rate_hz=10), InputError, "degrees"),
        (lambda at: audit_trajectory(at / "q.npz", t_s=[0, 1]), UsageError, "t_s: has no effect with a file"),
        (lambda at: audit_trajectory(np.zeros((4, 7)), rate_hz=10, reading={"tool": "tcp"}), UsageError, "reading"),
        (
            lambda at: audit_trajectory(np.zeros((4, 7)), rate_hz=10, robot="ur5"),
            UsageError,
            "expected panda, fr3, xarm7, ",
        ),
        (lambda at: score_videos(at / "videos", out=at / "out", engine="slurm"), UsageError, "'local', 'ray'"),
        (lambda at: score_videos(at / "videos", out=at / "out", shard="3"), UsageError, "I/N"),
    ],
)
def test_unusable_arguments_raise_one_line_errors(film, tmp_path, call, error, told):
    film("videos/a.mp4")
    film("videos/b.mp4")
    with pytest.raises(KinebenchError, match=told) as raised:
        call(tmp_path)
    assert type(raised.value) is error
    assert "\n" not in str(raised.value)


@pytest.mark.slow
def test_ground_video_then_audit_trajectory_equal_score_videos(tmp_path):
    np.save(tmp_path / "clip.npy", read_video(EXAMPLES / "PickFruits-v1_s0010_unseen.mp4").frames[20:29])
    [row] = score_videos(tmp_path / "clip.npy", out=tmp_path / "out", frame_period_s=0.2).rows
    grounded = ground_video(tmp_path / "clip.npy", frame_period_s=0.2)
    written = read_track(tmp_path / "out" / "tracks" / "clip.npz").track
    np.testing.assert_array_equal(grounded.track.X_BG, written.X_BG)
    np.testing.assert_array_equal(grounded.track.confidence, written.confidence)
    judged = audit_trajectory(grounded.track)
    assert judged.feasible is row.feasible
    assert {name: row.metrics[name] for name in judged.metrics} == dict(judged.metrics)


def test_error_messages_name_python_arguments_and_not_command_line_options(tmp_path, film):
    with pytest.raises(UsageError, match=r"^frame_period_s is -1"):
        score_videos(film("a.mp4"), out=tmp_path / "out", frame_period_s=-1.0)
    with pytest.raises(UsageError, match=r"^payload_kg is -1"):
        audit_trajectory(np.zeros((4, 7)), t_s=range(4), payload_kg=-1)
    with pytest.raises(InputError, match="or give rate_hz HZ"):
        audit_trajectory(np.zeros((4, 7)))
    with pytest.raises(UsageError, match=r"^world_model oracel"):
        run_suite(0, world_model="oracel", out=tmp_path / "out")


@pytest.mark.usefixtures("quick")
def test_warnings_of_a_run_are_python_warnings_at_the_call_site(program, tmp_path):
    np.save(tmp_path / "clip.npy", np.zeros((4, 96, 96, 3), np.uint8))
    with pytest.warns(UserWarning, match="no frame rate") as scored:
        score_videos(tmp_path / "clip.npy", out=tmp_path / "out")
    with pytest.warns(UserWarning, match="frame period of 200 s") as grounded:
        ground_video(tmp_path / "clip.npy", frame_period_s=200.0)
    assert {warning.filename for warning in (*scored, *grounded)} == {__file__}
