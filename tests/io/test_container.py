from pathlib import Path

import numpy as np

from kinebench_drake.io.container import join_videos, write_video
from tests.films import decoded


def test_joined_videos_keep_all_frames_in_order_at_the_frame_rate(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    coarse = [rng.integers(0, 255, (n, 8, 8, 3), dtype=np.uint8) for n in (9, 5, 14)]
    films = [np.kron(film, np.ones((1, 16, 16, 1), np.uint8)) for film in coarse]
    paths = [tmp_path / f"{k}.mp4" for k in range(3)]
    for path, film in zip(paths, films, strict=True):
        write_video(path, film, 5, keyframe_every=4)
    join_videos(tmp_path / "all.mp4", paths)
    times, pictures = decoded(tmp_path / "all.mp4")
    assert np.allclose(times, np.arange(28) / 5.0)
    assert np.array_equal(pictures, np.concatenate([decoded(path)[1] for path in paths]))
