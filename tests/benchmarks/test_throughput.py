import numpy as np
import pytest

from benchmarks import throughput
from benchmarks.process import ProcessMemory
from benchmarks.throughput import FinishedSample, Job, RunCost, Setting, figures, measure, section, summarize_seconds
from kinebench_drake.environment.precision import Precision
from kinebench_drake.errors import KinebenchError, UsageError
from kinebench_drake.results.row import Status

PEAK = ProcessMemory(main_mb=100.0, workers_mb=(900.0, 800.0))


def timed(processes, *, begins=3.0, first=2.0, each=5.0, samples=7):
    """Samples of processes in step; loading makes the first of each longer."""
    rounds = -(-samples // processes)
    ends = [begins + first + each * (1 + k) for k in range(rounds) for _ in range(processes)][:samples]
    took = [first + each] * processes + [each] * (samples - processes)
    return [sample(end_s, wall_s) for end_s, wall_s in zip(ends, took, strict=True)]


def sample(finished_s, wall_s, status=Status.OK):
    return FinishedSample(finished_s=finished_s, wall_s=wall_s, status=status)


@pytest.mark.parametrize(("processes", "sample_s"), [(1, 5.0), (2, 2.5)])
def test_start_up_ends_with_the_first_sample_of_each_process(processes, sample_s):
    samples = 9 if processes == 1 else 8
    cost = RunCost.from_samples(timed(processes, samples=samples), processes, PEAK)
    assert cost.start_up_s == pytest.approx(10.0)
    assert cost.wall_s == pytest.approx([5.0] * (samples - processes))
    assert cost.sample_s == pytest.approx(sample_s)


def test_samples_that_cannot_be_read_are_no_fast_samples():
    good = timed(1)
    missing = [sample(0.1 * k, 0.01, Status.ERROR) for k in range(5)]
    cost = RunCost.from_samples([*missing, *good], 1, PEAK)
    alone = RunCost.from_samples(good, 1, PEAK)
    assert (cost.start_up_s, cost.sample_s) == (alone.start_up_s, alone.sample_s)
    assert cost.wall_s.tolist() == alone.wall_s.tolist()
    with pytest.raises(KinebenchError, match="1 of 6 samples"):
        RunCost.from_samples([*missing, good[0]], 1, PEAK)


def turn(sample_s, mb=900.0, wall_s=(1.0, 1.0, 4.0)):
    peak = ProcessMemory(main_mb=100.0, workers_mb=(mb,))
    return RunCost(start_up_s=5.0, wall_s=np.array(wall_s), sample_s=sample_s, peak=peak)


def test_the_tables_have_ratios_within_a_turn_peak_memory_and_the_spread_of_videos():
    one, two = (Setting(job=Job.SCORE, processes=n, precision=Precision.FLOAT32) for n in (1, 2))
    costs = {one: [turn(8.0), turn(16.0)], two: [turn(5.0), turn(8.0, mb=950.0)]}
    text = section(costs, tracks=200)
    assert "| score in float32, 1 process | 5.0 | 12.00 (8.00 to 16.00) |" in text
    assert "| 1.80 (1.60 to 2.00) | 100 + 950 |" in text
    assert "4 different held-out renderings" in text
    assert "| score in float32, 1 process | 2.00 | 1.00 | 3.70 | 4.00 | 2.00 |" in text
    assert figures(costs)["score in float32, 1 process, s a video: maximum"] == 4.0


def test_the_mean_is_compared_with_the_faster_half_of_the_videos():
    assert summarize_seconds(np.array([9.0, 1.0, 3.0, 3.0]))["mean / mean of the faster half"] == 2.0


def test_a_setting_forces_its_precision():
    forced = Setting(job=Job.SCORE, processes=1, precision=Precision.BFLOAT16)
    assert forced.environment == {"KINEBENCH_DRAKE_PRECISION": "bfloat16"}
    assert Setting(job=Job.AUDIT, processes=1).environment == {}


def test_copies_of_a_video_count_once(tmp_path, monkeypatch):
    monkeypatch.setattr(throughput, "LEAST_VIDEOS", 2)
    for k in range(3):
        (tmp_path / f"{k}.mp4").write_bytes(b"one film")
    with pytest.raises(UsageError, match="holds 1 different video, expected 2 or more"):
        measure(tmp_path, tmp_path, tracks=9, turns=1, log=print)
