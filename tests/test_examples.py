"""The scripts of examples/ run and print what they promise."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.models.arm import load_robot
from kinebench_drake.results.store import read_rows
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.prompts import PromptTemplate
from kinebench_drake.suites.worldmodels.factory import create
from kinebench_drake.suites.worldmodels.worldmodel import Request
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from tests.films import shorten_clips

EXAMPLES = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
CLIP = EXAMPLES / "videos" / "PickFruits-v1_s0010_unseen.mp4"


@pytest.fixture
def clip(tmp_path):
    """Nine frames of an example video."""
    path = tmp_path / "videos" / "clip.mp4"
    path.parent.mkdir()
    write_video(path, read_video(CLIP).frames[20:29], 17)
    return path


@pytest.fixture
def run(monkeypatch, tmp_path, capsys):
    """Runs a script as `python examples/NAME.py ...` does, in an empty folder; returns what it prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def call(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return call


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_examples_are_short_and_have_a_docstring(script):
    text = script.read_text()
    assert len(text.splitlines()) < 80
    assert text.startswith(('"""', 'r"""'))


def test_the_example_of_arrays_judges_poses_and_joint_angles(run):
    told = run("audit_arrays.py")
    assert "poses, 2 s: feasible" in told
    assert "poses, 0.5 s: infeasible\n  acceleration of panda_joint" in told
    assert "as joint angles: feasible" in told


@pytest.mark.slow
def test_the_examples_of_a_folder_and_of_a_plotted_path_run(run, clip, tmp_path):
    told = run("score_folder.py", clip.parent, tmp_path / "out")
    assert "clip: feasible" in told
    assert "tracked 100%" in told
    assert (tmp_path / "out" / "report.html").is_file()
    assert list(read_rows(tmp_path / "out")) == ["clip"]
    assert "100% of 9 frames tracked" in run("plot_path.py", clip, tmp_path / "path.png")
    with Image.open(tmp_path / "path.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 10


@pytest.mark.slow
def test_the_example_of_samples_ranks_a_clip_that_shows_an_arm_first(run, clip):
    write_video(
        clip.with_name("noise.mp4"), np.random.default_rng(0).integers(256, size=(9, 96, 96, 3), dtype="u1"), 17
    )
    first, second, speed = run("best_of.py", clip.parent).splitlines()
    assert "clip: executable" in first
    assert second.startswith("0.000  noise: ")
    assert "clips a minute in 1 process" in speed


@pytest.mark.sapien
@pytest.mark.slow
def test_the_example_of_a_custom_world_model_runs_in_closed_loop(run, tmp_path, monkeypatch):
    shorten_clips(monkeypatch)
    told = run("closed_loop.py", tmp_path / "out")
    assert "PullCube-v1_s0000: failure" in told
    [row] = read_rows(tmp_path / "out").values()
    assert row.model == "dimmer"
    assert row.verdict == "task"


def test_the_example_server_answers_as_a_world_model(tmp_path):
    server = subprocess.Popen(
        [sys.executable, EXAMPLES / "world_model_server.py", "0"], stdout=subprocess.PIPE, text=True, cwd=tmp_path
    )
    try:
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1]
        frame = np.zeros((64, 96, 3), np.uint8)
        frame[:, :48] = (200, 40, 40)
        request = Request(
            episode="StackCube-v1_s0003",
            task="StackCube-v1",
            round=0,
            prompt="Stack the cubes.",
            negative_prompt="",
            seed=1,
            first_frame=frame,
            num_frames=5,
            fps=17.0,
        )
        video = read_video(create(f"{address}?timeout=30").generate(request, tmp_path / "answer"))
    finally:
        server.terminate()
        server.communicate()
    assert video.frames.shape == (5, 64, 96, 3)
    assert np.abs(video.frames[-1].astype(int) - frame).mean() < 5


CLONE = """
TASK_PROMPTS: dict[str, str] = {
    "CloseBox-v1": "Shut the box.", "PickFruits-v1": "Take the {fruit_name}.", "Other-v1": "x",
    "StoreFruitsBox-v1": "Store {fruit_sequence_text}.",
}
VISUAL_LOCK_PREFIX = ("Keep " "still. ")
raise SystemExit("it is run")
"""


def test_the_example_of_prompts_reads_a_clone_and_does_not_run_it(run, tmp_path):
    (tmp_path / "kinebench/eval").mkdir(parents=True)
    (tmp_path / "kinebench/tasks.py").write_text(CLONE)
    (tmp_path / "kinebench/eval/evaluator.py").write_text('NEGATIVE_PROMPT = ("pan, " "zoom")')
    (tmp_path / "prompts.json").write_text(run("kinebench_prompts.py", tmp_path))
    template = PromptTemplate.parse(tmp_path / "prompts.json")
    assert template.prompt(compose("CloseBox-v1", 3)) == "Keep still. Shut the box."
    assert template.negative == "pan, zoom"
    fruit = compose("PickFruits-v1", 3)
    target = fruit.prompt.partition("picks up the ")[2].partition(",")[0]
    assert template.prompt(fruit) == f"Keep still. Take the {target}."
    order = template.prompt(compose("StoreFruitsBox-v1", 3)).removeprefix("Keep still. Store ").rstrip(".")
    assert sorted(order.split(", ")) == ["apple", "banana", "orange"]
    other = compose("StackCube-v1", 3)
    assert template.prompt(other) == f"Keep still. {other.prompt}"


def test_the_example_of_a_recording_for_rerun_holds_arm_path_and_curves(run, tmp_path):
    pytest.importorskip("rerun")
    q = np.tile(load_robot().rest_q, (3, 1))
    X_BG = ArmPlant().forward_path(q)
    track = GripperTrack(
        t_s=0.2 * np.arange(3), X_CH=X_BG, X_BG=X_BG, tracked=np.ones(3, dtype=bool), confidence=np.ones(3),
        finger_width_m=np.zeros(3),
    )  # fmt: skip
    error = np.zeros(3)
    joints = JointTrack(t_s=track.t_s, q=q, status=(IkStatus.OK,) * 3, position_error_m=error, rotation_error_rad=error)
    write_track(tmp_path / "a.npz", track, joints, {})
    run("rerun_recording.py", tmp_path / "a.npz", tmp_path / "a.rrd")
    verified, listed = (
        subprocess.run(
            [sys.executable, "-m", "rerun", "rrd", command, tmp_path / "a.rrd"],
            capture_output=True,
            text=True,
            check=True,
        )
        for command in ("verify", "stats")
    )
    assert "1 file verified without error" in verified.stdout + verified.stderr
    entities = {"/base/path", "/base/tcp", "/base/arm/panda_hand", "/curves/confidence", "/curves/finger_width_m"}
    assert entities <= set(re.findall(r"^(/\S+):", listed.stdout, re.M))
