"""Closed loop from the command line: rows, resume, equal bytes, failures that end nothing."""

import io
import json
import shutil
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from kinebench_drake import cli
from kinebench_drake.clip_timing import sample_uniformly
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.suites.catalog import VERSION
from kinebench_drake.suites.clock import CLIP_S, FRAME_PERIOD_S
from kinebench_drake.suites.composition import Pool, compose
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import render_video, run_expert
from kinebench_drake.suites.simulator import Simulator, Snapshot
from tests.films import shorten_clips

pytestmark = [pytest.mark.sapien, pytest.mark.slow]


def run(out: Path, *options: str) -> tuple[int, str]:
    """Exit status and what was printed."""
    one = ("--suite", "0", "--tasks", "PullCube-v1", "--episodes", "1")
    return invoke("suite", "run", *one, "--out", str(out), *options)


def invoke(*command: str) -> tuple[int, str]:
    """Exit status and what was printed."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said), pytest.raises(SystemExit) as stop:
        cli.main(list(command))
    return int(stop.value.code or 0), said.getvalue()


def rows(out: Path) -> list[dict]:
    return [json.loads(line) for line in (out / "samples.jsonl").read_text().splitlines()]


@pytest.fixture(scope="module")
def oracle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("oracle")
    code, said = run(out, "--world-model", "oracle", "--pixels-only")
    assert code == 0, said
    return out


def test_the_oracle_succeeds_from_pixels_only(oracle: Path) -> None:
    [row] = rows(oracle)
    assert row["success"] is True
    assert row["progress"] == 1.0
    assert row["verdict"] is None
    assert row["rounds"] == 1
    assert row["metrics"]["gap_robot_iou"] > 0.8
    assert row["metrics"]["gap_gripper_m"] < 0.01
    assert (oracle / row["video"]).is_file()
    assert (oracle / "thumbnails" / f"{row['id']}.jpg").is_file()
    page = (oracle / "report.html").read_text()
    assert "oracle, suite 0 (test)" in page
    assert f"rollouts/{row['id']}.mp4" in page
    assert (oracle / "rollouts" / f"{row['id']}.mp4").is_file()
    assert json.loads((oracle / "results.json").read_text())["suite_version"] == VERSION
    with np.load(oracle / "tracks" / f"{row['id']}.npz") as track:
        assert track["base_from_tcp"].shape == (row["frames"], 4, 4)


def test_a_finished_suite_run_is_not_repeated_and_a_second_run_has_equal_rows(oracle: Path, tmp_path: Path) -> None:
    before = (oracle / "samples.jsonl").read_bytes()
    stamp = (oracle / "rollouts").stat().st_mtime_ns
    _, said = run(oracle, "--world-model", "oracle", "--pixels-only")
    assert "finished already" in said
    assert (oracle / "rollouts").stat().st_mtime_ns == stamp
    assert run(tmp_path, "--world-model", "oracle", "--pixels-only", "--replays", "0")[0] == 0
    assert (tmp_path / "samples.jsonl").read_bytes() == before


def test_two_rounds_from_a_video_folder_equal_two_rounds_of_a_live_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each command ends with the first frames of the next round; the last row differs in the model's identity only."""
    shorten_clips(monkeypatch)
    live = tmp_path / "live"
    offline = tmp_path / "offline"
    videos = tmp_path / "videos"
    videos.mkdir()
    (tmp_path / "prompts.json").write_text('{"*": "{prompt} Slowly."}')
    prompts = ("--prompts", str(tmp_path / "prompts.json"))
    options = ("--rounds", "2", "--clip-timing", "native", *prompts, "--replays", "0")
    assert run(live, "--world-model", "random", *options)[0] == 0
    [row] = rows(live)
    assert (row["success"], row["rounds"], row["clip_frames"]) == (False, 2, [13, 13])
    for number in range(2):
        id = row["id"] if number == 0 else f"{row['id']}_r{number}"
        if number:
            [asked] = [json.loads(line) for line in (offline / "ask" / "manifest.jsonl").read_text().splitlines()]
            assert (asked["id"], asked["video"], asked["prompt"]) == (id, f"{id}.mp4", row["prompt"])
            first = np.asarray(Image.open(offline / "ask" / asked["first_frame"]))
            shown = read_video(live / row["videos"][number]).frames[0]
            assert np.abs(first.astype(int) - shown).mean() < 5
            assert [path.name for path in (offline / "ask").glob("*.png")] == [asked["first_frame"]]
            [sample] = find_samples(offline / "ask" / "manifest.jsonl").samples
            assert sample.initial_state is not None
        shutil.copy(live / row["videos"][number], videos / f"{id}.mp4")
        code, said = run(offline, "--world-model", f"folder:{videos}?name=random", *options)
        assert code == 0, said
        [now] = rows(offline)
        if number == 0:
            assert (now["status"], "success" in now) == ("unmeasurable", False)
            assert f"waits for the video of round 2: generate {row['id']}_r1.mp4" in now["reason"]
            assert "next round of 1 episode: generate the videos of" in said
            assert run(offline, "--world-model", f"folder:{videos}?name=random", *options)[0] == 0
    assert not (offline / "ask").exists()
    assert {key for key in row if row[key] != now[key]} == {"content_hash", "input_sha256"}
    for folder in ("tracks", "thumbnails", "rollouts"):
        for path in (live / folder).iterdir():
            assert (offline / folder / path.name).read_bytes() == path.read_bytes(), path.name
    one, other = (json.loads((out / "results.json").read_text()) for out in (live, offline))
    assert {key for key in one["config"] if one["config"][key] != other["config"][key]} == {"world_model_sha256"}
    assert one["aggregates"] == other["aggregates"]


@pytest.fixture(scope="module")
def still(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run over the videos of an earlier run of the same episode."""
    out = tmp_path_factory.mktemp("still")
    videos = out / "videos"
    (videos / "PullCube-v1_s0000_r2").mkdir(parents=True)
    (videos / "PullCube-v1_s0000_r2" / "0.png").touch()
    (videos / "PullCube-v1_s0000_r1.mp4").touch()
    (videos / "other_r1.mp4").touch()
    with pytest.MonkeyPatch.context() as patch:
        shorten_clips(patch)
        options = ("--rounds", "1", "--no-rollouts", "--replays", "0", "--overwrite")
        assert run(out, "--world-model", "still", *options)[0] == 0
    return out


def test_rerunning_an_episode_removes_its_earlier_videos(still: Path) -> None:
    assert sorted(video.name for video in (still / "videos").iterdir()) == ["PullCube-v1_s0000_r0.mp4", "other_r1.mp4"]


def test_a_letterboxed_video_is_grounded_and_shown_without_its_bars(oracle: Path, tmp_path: Path) -> None:
    """832x480, as Wan makes them, from a square picture: success, and a gap as small as that of the video itself."""
    [row] = rows(oracle)
    frames = read_video(oracle / row["video"]).frames
    boxed = np.zeros((len(frames), 480, 832, 3), np.uint8)
    boxed[:, :, 176:656] = [cv2.resize(frame, (480, 480), interpolation=cv2.INTER_CUBIC) for frame in frames]
    (tmp_path / "videos").mkdir()
    film = tmp_path / "videos" / f"{row['id']}.mp4"
    write_video(film, boxed, 16)
    film.rename(film.with_suffix(".mov"))
    options = ("--pixels-only", "--replays", "0")
    assert run(tmp_path / "out", "--world-model", f"folder:{tmp_path / 'videos'}", *options)[0] == 0
    [other] = rows(tmp_path / "out")
    assert other["success"] is True
    assert other["video"] == f"videos/{row['id']}_r0.mov"
    assert (tmp_path / "out" / other["video"]).is_file()
    assert other["metrics"]["gap_robot_iou"] > row["metrics"]["gap_robot_iou"] - 0.05


@pytest.fixture(scope="module")
def long_film(oracle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the oracle's clip in 150 frames, as a service might return it.

    Only the frames that lie nearest to the task's clock are rendered: the others repeat the one before.
    """
    [row] = rows(oracle)
    episode = compose(row["task"], row["seed"], pool=Pool(row["pool"]))
    with Simulator(episode.task) as simulator:
        steps = run_expert(simulator, find_expert(episode.task), episode, every=1).snapshots[: 48 * 4 + 1]
        at = np.linspace(0, len(steps) - 1, 150)
        chosen, _ = sample_uniformly(150, CLIP_S, FRAME_PERIOD_S)
        video = render_video(simulator, [between(steps, at[number]) for number in chosen])
    folder = tmp_path_factory.mktemp("long")
    shown = np.searchsorted(chosen, np.arange(150), side="right") - 1
    write_video(folder / f"{row['id']}.mp4", video.rgb[shown], 30)
    return folder


def between(steps: Sequence[Snapshot], at: float) -> Snapshot:
    """The state between two control steps."""
    one = steps[int(at)]
    other = steps[min(int(at) + 1, len(steps) - 1)]
    share = at - int(at)

    def mix(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (1 - share) * np.asarray(a) + share * np.asarray(b)

    objects = {name: mix(raw, other.objects[name]) for name, raw in one.objects.items()}
    for raw in objects.values():
        raw[3:] /= np.linalg.norm(raw[3:])
    return Snapshot(
        q=mix(one.q, other.q),
        fingers_m=mix(one.fingers_m, other.fingers_m),
        objects=objects,
        joints={name: float(mix(value, other.joints[name])) for name, value in one.joints.items()},
    )


def test_a_clip_of_150_frames_has_the_metrics_of_the_same_clip_of_49_frames(
    oracle: Path, long_film: Path, tmp_path: Path
) -> None:
    """Rendered, grounded and executed: metrics differ by the errors of grounding other frames, and not by the clock."""
    options = ("--pixels-only", "--no-rollouts", "--replays", "0")
    code, said = run(tmp_path / "even", "--world-model", f"folder:{long_film}", *options)
    assert code == 0
    assert "1 episode with clips of 150 frames in place of 49: each was sampled evenly over 9.6 s" in said
    [reference] = rows(oracle)
    [row] = rows(tmp_path / "even")
    assert row["success"] is True
    assert (row["clip_timing"], row["clip_frames"], row["frames"]) == ("uniform", [150], 49)
    assert (reference["clip_timing"], reference["clip_frames"]) == ("native", [49])
    one = reference["metrics"]
    other = row["metrics"]
    for name, most in (("sparc", 0.02), ("sparc_filtered", 0.02), ("ldlj", 0.05), ("manipulability_integral", 0.01)):
        assert other[name] == pytest.approx(one[name], rel=most), name
    (tmp_path / "first").mkdir()
    [film] = long_film.iterdir()
    write_video(tmp_path / "first" / film.name, read_video(film).frames[:52], 30)
    options += ("--clip-timing", "native", "--rounds", "1")
    _, said = run(tmp_path / "slow", "--world-model", f"folder:{tmp_path / 'first'}", *options)
    assert "52 frames in place of 49: 0.2 s a frame were taken" in said
    [slow] = rows(tmp_path / "slow")
    for metrics, duration_s in ((one, 48 * 0.2), (slow["metrics"], 51 * 0.2)):
        mean = metrics["manipulability_mean"]
        integral = metrics["manipulability_integral"]
        assert integral == pytest.approx(mean * duration_s, rel=0.01)


def test_a_still_video_fails_with_the_task_as_cause(still: Path) -> None:
    [row] = rows(still)
    assert row["success"] is False
    assert row["verdict"] == row["cause"]["verdict"] == "task"
    assert row["missed"]


def test_an_episode_without_a_video_is_an_error_row(tmp_path: Path) -> None:
    (tmp_path / "videos").mkdir()
    code, _ = run(tmp_path / "out", "--world-model", f"folder:{tmp_path / 'videos'}", "--rounds", "1")
    [row] = rows(tmp_path / "out")
    assert code == 1
    assert row["status"] == "error"
    assert row["id"] in row["reason"]


def test_unknown_world_model_specifications_are_refused(tmp_path: Path) -> None:
    code, said = run(tmp_path / "out", "--world-model", "oracel")
    assert code == 2
    assert "one of" in said
