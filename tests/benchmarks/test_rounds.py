from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks import rounds
from benchmarks.rounds import RoundTiming, Stage, StageClock, figures, section
from kinebench_drake.suites.closed_loop.execution import CommandPlanner
from kinebench_drake.suites.runs.episodes import EpisodeEvaluator
from kinebench_drake.suites.simulator import Simulator


class Processor:
    """Clock that advances only by work."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def process_time(self) -> float:
        return self.now_s

    def work(self, seconds: float) -> None:
        self.now_s += seconds


def test_a_nested_stage_counts_towards_the_outer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    processor = Processor()

    def reset(simulator: Any) -> None:
        processor.work(3.0)
        simulator.render()

    def evaluate(evaluator: Any, sample: Any, resources: Any) -> None:
        simulator = object.__new__(Simulator)
        simulator.reset(sample)
        object.__new__(CommandPlanner).plan()  # type: ignore[call-arg]
        processor.work(4.0)

    monkeypatch.setattr(rounds, "time", processor)
    monkeypatch.setattr(Simulator, "render", lambda self: processor.work(2.0))
    monkeypatch.setattr(Simulator, "reset", lambda self, episode: reset(self))
    monkeypatch.setattr(CommandPlanner, "plan", lambda self: processor.work(1.0))
    monkeypatch.setattr(EpisodeEvaluator, "evaluate", evaluate)
    clock = StageClock()
    with clock.running():
        EpisodeEvaluator.evaluate(None, SimpleNamespace(id="one"), None)  # type: ignore[arg-type]
    before = processor.now_s
    EpisodeEvaluator.evaluate(None, SimpleNamespace(id="two"), None)  # type: ignore[arg-type]
    assert processor.now_s == 2 * before  # timed and untimed do the same
    assert clock.episodes == {
        "one": {**dict.fromkeys(Stage, 0.0), Stage.RESET: 5.0, Stage.COMMANDS: 1.0, Stage.REST: 4.0}
    }


def test_times_are_per_round_and_add_up() -> None:
    seconds = {**dict.fromkeys(Stage, 0.0), Stage.MODEL: 6.0, Stage.GROUNDING: 2.0}
    timing = RoundTiming(rounds=4, episodes=3, successes=3, seconds=seconds)
    text = section(timing)
    assert f"| {Stage.GROUNDING.value} | 0.5 |" in text
    assert Stage.RESET.value not in text
    assert "| all | 2.0 |" in text
    assert "Without the world model a round takes 0.5 s" in text
    assert figures(timing)[f"{Stage.MODEL.value} [s]"] == 1.5
