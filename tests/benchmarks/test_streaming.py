from pathlib import Path

import numpy as np
import pytest

from benchmarks.process import ProcessMemory, ProcessRun
from benchmarks.streaming import StreamingResult, cut_videos, growth, section
from kinebench_drake.errors import UsageError
from kinebench_drake.io.reader import read_video

EXAMPLES = Path(__file__).parents[2] / "examples" / "videos"


def grown(main, worker, counts=range(20, 2001, 20)):
    """Memory that grows by so much per 1,000 samples after it doubled at the start."""
    return {
        n: ProcessMemory(
            main_mb=200.0 + main * n / 1000.0, workers_mb=(800.0 if n > 100 else 400.0, 900.0 + worker * n / 1e3)
        )
        for n in counts
    }


def run_of(memory):
    return ProcessRun(wall_s=1000.0, finished_s=(), memory=memory, peak=memory[2000])


def test_memory_growth_is_measured_after_the_start_phase():
    main, workers = growth(run_of(grown(5.0, -3.0)), after=500)
    assert main == pytest.approx(5.0)
    np.testing.assert_allclose(workers, [0.0, -3.0], atol=1e-9)


def test_workers_that_ended_do_not_count_towards_memory_growth():
    memory = grown(5.0, -3.0)
    memory[2000] = ProcessMemory(main_mb=memory[2000].main_mb, workers_mb=(800.0,))
    np.testing.assert_allclose(growth(run_of(memory), after=500)[1], [0.0, -3.0], atol=1e-9)


def test_the_section_lists_memory_of_main_process_and_workers():
    memory = grown(5.0, 0.0)
    memory[2000] = ProcessMemory(main_mb=memory[2000].main_mb, workers_mb=(800.0,))
    text = section(
        StreamingResult(
            samples=2000,
            frames=4,
            jobs=2,
            run=run_of(memory),
            rows_mb=11.0,
            report_mb=8.0,
            report_s=4.0,
            again_s=6.0,
        )
    )
    assert "the main process holds 210 MB" in text
    assert "main process 5.0 MB" in text
    assert "workers 0.0 MB and 0.0 MB" in text


def test_cut_videos_are_pieces_linked_under_several_names(tmp_path):
    (tmp_path / "in").mkdir()
    film = next(EXAMPLES.glob("*.mp4"))
    (tmp_path / "in" / film.name).symlink_to(film)
    cut_videos(tmp_path / "in", tmp_path / "out", 30, 20)
    found = sorted((tmp_path / "out").iterdir())
    assert len(found) == 30
    assert len({path.stat().st_ino for path in found}) == 2  # 49 frames hold two pieces of 20
    assert read_video(found[0]).frames.shape == (20, 384, 384, 3)
    with pytest.raises(UsageError, match="holds no mp4 of 50 frames"):
        cut_videos(tmp_path / "in", tmp_path / "long", 1, 50)
