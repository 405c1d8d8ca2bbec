import numpy as np
import pytest

from benchmarks.process import ProcessMemory
from benchmarks.throughput import Job, RunCost, Setting, link_copies, measure, section
from kinebench_drake.errors import UsageError

PEAK = ProcessMemory(main_mb=100.0, workers_mb=(900.0, 800.0))


def timed(processes, *, begins=3.0, first=2.0, each=5.0, samples=7):
    """When samples end and how long each takes, with processes in step; loading makes the first of each longer."""
    rounds = -(-samples // processes)
    ends = [begins + first + each * (1 + k) for k in range(rounds) for _ in range(processes)][:samples]
    took = [first + each] * processes + [each] * (samples - processes)
    return ends, took


@pytest.mark.parametrize(("processes", "sample_s"), [(1, 5.0), (2, 2.5)])
def test_start_up_time_is_separated_from_time_per_sample(processes, sample_s):
    cost = RunCost.from_times(*timed(processes, samples=9 if processes == 1 else 8), processes, PEAK)
    assert cost.start_up_s == pytest.approx(3.0)
    assert cost.first_s == pytest.approx(2.0)
    assert cost.sample_s == pytest.approx(sample_s)


def test_the_table_has_ratios_within_a_turn_and_peak_memory():
    def turn(sample_s, mb=900.0):
        return RunCost(
            start_up_s=3.0, first_s=2.0, sample_s=sample_s, peak=ProcessMemory(main_mb=100.0, workers_mb=(mb,))
        )

    one, two = (Setting(job=Job.SCORE, processes=n) for n in (1, 2))
    text = section({one: [turn(8.0), turn(16.0)], two: [turn(5.0), turn(8.0, mb=950.0)]}, videos=12, tracks=200)
    assert "| score, 1 process | 3.0 + 2.0 | 12.00 (8.00 to 16.00) |" in text
    assert "| 1.80 (1.60 to 2.00) | 100 + 950 |" in text
    assert "12 copies" in text


def test_copies_are_hard_links(tmp_path):
    film = tmp_path / "film.mp4"
    film.write_bytes(np.random.default_rng(0).bytes(1000))
    names = [tmp_path / "in" / f"{k}.mp4" for k in range(3)]
    link_copies(film, names)
    assert {name.read_bytes() for name in names} == {film.read_bytes()}
    assert len({name.stat().st_ino for name in names}) == 1


def test_too_few_samples_are_refused(tmp_path):
    with pytest.raises(UsageError, match="2 samples are too few, expected more than 2"):
        measure(tmp_path / "a.mp4", tmp_path, videos=2, tracks=9, turns=1, log=print)
