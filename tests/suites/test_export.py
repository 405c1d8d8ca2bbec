"""First frames, prompts and camera for world models."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import SetupError, UsageError
from kinebench_drake.executors.base import ExecutorKind, create_executor
from kinebench_drake.formats.camerafile import load_camera, save_camera
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.suites.catalog import load_suite
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.export import ExportConfig, export_suite
from kinebench_drake.suites.families.task import TaskVariant
from kinebench_drake.suites.prompts import PromptTemplate
from kinebench_drake.suites.simulator import Simulator
from tests.suites.orders import Recorder

TASKS = ("PullCube-v1", "StackCube-v1")


def export(
    out: Path, tasks: tuple[str, ...], count: int, prompts: PromptTemplate | None = None, size: int = 96
) -> Path:
    order = ExportConfig(
        suite=load_suite(0),
        split="test",
        tasks=tasks,
        episodes=count,
        seed=0,
        variant=TaskVariant.PLAIN,
        size=size,
        out=out,
        prompts=prompts or PromptTemplate(),
    )
    observer = Recorder()
    assert (
        export_suite(order, create_executor(ExecutorKind.LOCAL, 1), observer) == observer.total == len(observer.lines)
    )
    return out


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export(tmp_path_factory.mktemp("export") / "out", TASKS, 2)


@pytest.mark.sapien
def test_exported_first_frames_equal_the_rendered_reset(exported: Path) -> None:
    with Simulator("StackCube-v1", camera=benchmark_camera().resized(96, 96)) as stage:
        stage.reset(compose("StackCube-v1", 1))
        rgb = stage.render().rgb
        X_BG = stage.scene().X_BG
    assert np.array_equal(np.asarray(Image.open(exported / "StackCube-v1_s0001.png")), rgb)
    samples = {sample.id: sample for sample in find_samples(exported / "manifest.jsonl").samples}
    first = samples["StackCube-v1_s0001"].initial_state
    assert first is not None
    assert np.allclose(first.X_BG, X_BG, atol=1e-6)
    assert first.finger_width_m == pytest.approx(0.08, abs=1e-6)


@pytest.mark.sapien
def test_exported_files_do_not_depend_on_other_episodes(exported: Path, tmp_path: Path) -> None:
    alone = export(tmp_path / "alone", TASKS[1:], 2)
    for name in ("StackCube-v1_s0000.png", "StackCube-v1_s0001.png", "camera.json"):
        assert (alone / name).read_bytes() == (exported / name).read_bytes()


@pytest.mark.sapien
def test_the_exported_manifest_is_readable_by_score(exported: Path) -> None:
    inputs = find_samples(exported / "manifest.jsonl")
    assert not inputs.warnings
    assert [sample.id for sample in inputs.samples] == [f"{task}_s000{k}" for task in TASKS for k in range(2)]
    for sample in inputs.samples:
        assert sample.path == exported / f"{sample.id}.mp4"
        assert sample.frame_period_s == 0.2
        assert sample.problem is None
        assert sample.prompt
    assert load_camera(exported / "camera.json").camera.width == 96


@pytest.mark.sapien
def test_exported_prompts_equal_those_of_a_run_with_the_same_options(exported: Path, tmp_path: Path) -> None:
    template = PromptTemplate(texts={"*": "Still camera. {prompt}"}, negative="blur")
    asked = export(tmp_path / "asked", TASKS[1:], 1, template)
    [sample] = find_samples(asked / "manifest.jsonl").samples
    assert sample.prompt == template.prompt(compose("StackCube-v1", 0))
    assert not find_samples(asked / "manifest.jsonl").warnings
    assert json.loads((asked / "manifest.jsonl").read_text())["negative_prompt"] == "blur"
    assert json.loads((asked / "suite.json").read_text())["prompts"] == dict(template.texts)
    assert "negative_prompt" not in (exported / "manifest.jsonl").read_text()
    with pytest.raises(UsageError, match=r"holds an export of prompts .*Still camera"):
        export(asked, TASKS[1:], 1)


@pytest.mark.sapien
def test_episodes_jsonl_has_assets_looks_and_task_properties(exported: Path) -> None:
    rows = [json.loads(line) for line in (exported / "episodes.jsonl").read_text().splitlines()]
    for row in rows:
        episode = compose(row["task"], row["seed"])
        assert row["id"] == episode.id
        assert row["assets"] == episode.assets
        assert (row["table"], row["background"], row["light"]) == (episode.table, episode.background, episode.light)
        assert {"difficulty", "articulated_dof", "contacts", "horizon"} <= row.keys()
    text = "".join(path.read_text() for path in exported.glob("*.json*"))
    assert str(exported.parent) not in text


@pytest.mark.sapien
def test_an_export_folder_is_extended_by_equal_settings_or_refused(tmp_path: Path) -> None:
    """More episodes of the same settings are added; nothing that the folder holds is lost or left without a row."""
    out = export(tmp_path / "out", TASKS[:1], 1)
    (out / "PullCube-v1_s0000.mp4").touch()
    content = {path.name: path.read_bytes() for path in out.iterdir()}
    for tasks, count, size, told in (
        (TASKS[1:], 1, 96, r"1 of its 1 episodes \(such as PullCube-v1_s0000\) are not in this export"),
        (TASKS, 1, 128, "holds an export of width 96, this one is of 128"),
    ):
        with pytest.raises(UsageError, match=told):
            export(out, tasks, count, size=size)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == content
    export(out, TASKS, 1)
    assert [json.loads(line)["id"] for line in (out / "manifest.jsonl").read_text().splitlines()] == [
        "PullCube-v1_s0000",
        "StackCube-v1_s0000",
    ]
    assert (out / "PullCube-v1_s0000.mp4").is_file()


@pytest.mark.parametrize("name", ["manifest.jsonl", "samples.jsonl", "suite.json"])
def test_a_folder_with_files_of_another_command_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("{}\n")
    with pytest.raises(UsageError, match=f"holds {name}, which no export wrote; name another folder"):
        export(tmp_path, TASKS, 1)


def test_a_file_in_place_of_the_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot be made a folder"):
        export(tmp_path / "file", TASKS, 1)
    with pytest.raises(SetupError, match="cannot write a"):
        write_atomically(tmp_path / "file" / "a.txt", b"")
    with pytest.raises(SetupError, match="cannot write camera"):
        save_camera(benchmark_camera(), tmp_path / "file" / "camera.json")
