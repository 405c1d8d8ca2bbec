"""Contact sheets: layout of the page and content of the panels."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from kinebench_drake.cli import cli
from kinebench_drake.executors.base import ExecutorKind, ItemResult, WorkerCrash, create_executor
from kinebench_drake.suites.composition import Episode, compose
from kinebench_drake.suites.contact_sheet import Panel, draw_sheet, task_panels


def _shot(level: int) -> Panel:
    pictures = tuple(np.full((8, 8, 3), level + i, dtype=np.uint8) for i in range(2))
    return Panel(title="Task-v1", text="The robot arm does what it is told to do, word by word, " * 3, images=pictures)


def _pixels(panels: Sequence[Panel]) -> np.ndarray:
    figure = draw_sheet(panels)
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)


def test_every_image_is_on_the_sheet_in_order() -> None:
    page = _pixels([_shot(10 * i) for i in range(1, 6)])
    places = []
    for level in [10 * i + k for i in range(1, 6) for k in range(2)]:
        rows, columns = np.nonzero((page == level).all(axis=-1))
        assert np.ptp(rows) > 100
        places.append((round(rows.mean() / 200), columns.mean()))
    assert places == sorted(places)


def test_a_failed_panel_is_marked_red() -> None:
    def redness(failed: bool) -> int:
        page = _pixels([Panel(title="Task-v1", text="not above", failed=failed)])
        return int((page[..., 0] - page[..., 1] > 60).sum())

    assert redness(False) == 0
    assert redness(True) > 50


class _Backwards:
    """An engine that finishes the last first, and whose worker dies over one."""

    def run(
        self, make_worker: object, items: Sequence[Episode]
    ) -> Iterator[ItemResult[Episode, Panel] | WorkerCrash[Episode]]:
        for item in reversed(items):
            if item.task == "PullCube-v1":
                yield WorkerCrash(item=item, reason="the worker was killed")
            else:
                yield ItemResult(item=item, result=Panel(title=item.task, text=item.prompt))


def test_panels_keep_the_order_of_the_request() -> None:
    tasks = ["StackCube-v1", "PullCube-v1", "CloseBox-v1"]
    panels = task_panels(_Backwards(), [compose(task, 0) for task in tasks])
    assert [panel.title for panel in panels] == tasks
    assert [panel.failed for panel in panels] == [False, True, False]
    assert "killed" in panels[1].text


@pytest.mark.sapien
def test_a_panel_shows_first_and_last_frame() -> None:
    [panel] = task_panels(create_executor(ExecutorKind.LOCAL, 1), [compose("StackCube-v1", 0)])
    assert not panel.failed
    first, last = panel.images
    assert first.shape == last.shape == (384, 384, 3)
    assert (first != last).any(axis=-1).mean() > 0.05


def test_the_sheet_command_writes_an_image(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "kinebench_drake.suites.contact_sheet.task_panels", lambda executor, episodes: [_shot(9)] * len(episodes)
    )
    out = tmp_path / "sheet.jpg"
    done = CliRunner().invoke(cli, ["suite", "sheet", "--tasks", "StackCube-v1,PullCube-v1", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "2 panels, 0 failed" in done.output
    assert Image.open(out).width > 700


def test_the_sheet_command_refuses_other_file_types() -> None:
    done = CliRunner().invoke(cli, ["suite", "sheet", "--out", "sheet.gif"])
    assert done.exit_code != 0
