"""Videos of a model: stored beside the other videos of a run, and brought to the task's clock."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.clip_timing import ClipTiming
from kinebench_drake.errors import InputError
from kinebench_drake.suites.closed_loop import loop as module
from kinebench_drake.suites.closed_loop.loop import ClosedLoop, LoopOptions, Round
from kinebench_drake.suites.composition import compose
from kinebench_drake.suites.seeding import generator
from kinebench_drake.suites.worldmodels.media import place_beside
from kinebench_drake.suites.worldmodels.worldmodel import WorldModelError


@pytest.fixture
def out(tmp_path: Path) -> Path:
    (tmp_path / "out" / "videos").mkdir(parents=True)
    return tmp_path / "out" / "videos" / "PullCube-v1_s0000_r0"


def frames(folder: Path, count: int) -> Path:
    """A folder of frames."""
    folder.mkdir(parents=True)
    for number in range(count):
        (folder / f"{number}.png").write_bytes(b"%d" % count)
    return folder


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_copy_of_a_frame_folder_replaces_the_earlier_one(tmp_path: Path, out: Path) -> None:
    place_beside(frames(tmp_path / "five", 5), out)
    assert place_beside(frames(tmp_path / "three", 3), out) == out
    assert names(out) == ["0.png", "1.png", "2.png"]


def test_a_copy_is_the_only_video_of_its_round(tmp_path: Path, out: Path) -> None:
    place_beside(frames(tmp_path / "five", 5), out)
    for suffix in (".mp4", ".gif"):
        (tmp_path / f"film{suffix}").write_bytes(suffix.encode())
        copy = place_beside(tmp_path / f"film{suffix}", out)
        assert names(out.parent) == [copy.name] == [f"{out.name}{suffix}"]


def test_a_clip_already_beside_the_others_is_not_copied(out: Path) -> None:
    beside = frames(out.parent / "PullCube-v1_s0000", 2)
    assert place_beside(beside, out) == beside
    within = frames(out / "work", 3)
    assert place_beside(within, out) == out
    assert names(within) == ["0.png", "1.png", "2.png"]
    assert names(out) == [*names(within), "work"]


@pytest.mark.parametrize(
    ("model", "option", "timing"),
    [
        (SimpleNamespace(), None, ClipTiming.NATIVE),
        (SimpleNamespace(chooses_length=False), None, ClipTiming.NATIVE),
        (SimpleNamespace(chooses_length=True), None, ClipTiming.UNIFORM),
        (SimpleNamespace(chooses_length=True), ClipTiming.NATIVE, ClipTiming.NATIVE),
        (SimpleNamespace(), ClipTiming.UNIFORM, ClipTiming.UNIFORM),
    ],
)
def test_clips_of_models_that_choose_the_length_are_resampled_uniformly(
    model: SimpleNamespace, option: ClipTiming | None, timing: ClipTiming
) -> None:
    loop = ClosedLoop(None, None, model, LoopOptions(clip_timing=option))
    used, chosen, t_s = loop.choose_frames(150)
    assert used is timing
    assert (len(chosen), t_s[-1]) == ((49, pytest.approx(9.6)) if timing is ClipTiming.UNIFORM else (150, 0.2 * 149))
    for frames in (2, 25, 49):
        used, chosen, t_s = loop.choose_frames(frames)
        assert chosen.tolist() == list(range(frames))
    np.testing.assert_array_equal(t_s, 0.2 * np.arange(49))


class Stuck:
    """Simulator whose task is not done, and the expert, which finds no path from its second state on."""

    camera = None

    def __init__(self, tracks: int) -> None:
        self._left = tracks

    def reset(self, episode: object) -> None: ...

    def snapshot(self) -> SimpleNamespace:
        return SimpleNamespace(q=np.zeros(7), finger_width_m=0.0)

    def render(self) -> SimpleNamespace:
        return SimpleNamespace(rgb=np.zeros((4, 4, 3), np.uint8))

    def simulation_state(self) -> dict[str, object]:
        return {}

    def outcome(self) -> SimpleNamespace:
        return SimpleNamespace(success=False)

    def use(self) -> None:
        self._left -= 1
        if self._left < 0:
            raise InputError("the expert's path leaves the workspace")

    def track(self, *_: object) -> None:
        self.use()

    def set_state(self, *_: object) -> None: ...

    def generate(self, request: object, out: Path) -> Path:
        try:
            self.use()
        except InputError as error:
            raise WorldModelError(str(error)) from None
        out.write_bytes(b"")
        return out


@pytest.mark.parametrize("privileged", [True, False])
def test_an_episode_that_no_expert_can_continue_has_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, privileged: bool
) -> None:
    round_ = Round(
        video=tmp_path / "x", timing=ClipTiming.NATIVE, generated_frames=49, frames=None, robot=None,
        grounding=SimpleNamespace(track=None),
    )  # fmt: skip
    monkeypatch.setattr(ClosedLoop, "ground_round", lambda *_: round_)
    monkeypatch.setattr(ClosedLoop, "plan_round", lambda *_: (SimpleNamespace(gripping=False), None))
    monkeypatch.setattr(module, "execute", lambda *_: SimpleNamespace(outcome=SimpleNamespace(success=False)))
    for tracks in (1, 0):
        stuck = Stuck(tracks)
        model = stuck if privileged else SimpleNamespace(generate=Stuck(9).generate)
        loop = ClosedLoop(None, None, model, LoopOptions(), None if privileged else stuck)
        if tracks == 0:
            with pytest.raises((InputError, WorldModelError), match="leaves the workspace"):
                loop.run(stuck, compose("PullCube-v1", 0), tmp_path / "x")
            continue
        run = loop.run(stuck, compose("PullCube-v1", 0), tmp_path / "x")
        assert (len(run.rounds), run.outcome.success, run.pending) == (1, False, None)


def test_each_sample_and_round_has_its_own_seed() -> None:
    loop = ClosedLoop(None, None, SimpleNamespace(), LoopOptions())
    episode = compose("PullCube-v1", 0)
    frame = np.zeros((4, 4, 3), np.uint8)
    seeds = [[loop.make_request(episode, "id", k, number, frame).seed for number in range(3)] for k in range(4)]
    assert len({seed for own in seeds for seed in own}) == 12
    assert seeds[0][0] == int(generator("world model", episode.id, 0, 0).integers(2**31))
