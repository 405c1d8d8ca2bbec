import numpy as np

from kinebench_drake.formats.lerobot.writer import histogram_statistics, row_statistics


def test_histogram_statistics_equal_those_of_the_pixels() -> None:
    pixels = np.random.default_rng(0).integers(3, 250, (1000, 3))
    counts = np.stack([np.bincount(pixels[:, c], minlength=256) for c in range(3)])
    rows = row_statistics(pixels / 255.0)
    levels = histogram_statistics(counts, 7)
    assert levels["count"] == [7]
    for name in ("min", "max", "mean", "std", "q01", "q50", "q99"):
        assert np.allclose(np.ravel(levels[name]), rows[name], atol=1.0 / 255.0)
