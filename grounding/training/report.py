"""The measurements as lines of text: what `kinebench-drake perception calibrate` prints."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.training.dataset import Shards
from kinebench_drake.grounding.training.holdout import HOLDOUT_SEED, calibrate, measure, reliability
from kinebench_drake.grounding.training.render import render
from kinebench_drake.models.perception.weights import WEIGHTS, load_network


def holdout_lines(
    data: Path, demos: Sequence[Path], weights: Path | None, scenes: int, out: Path | None, jobs: int
) -> Iterator[str]:
    """Measure single held-out frames, fit the confidence to the even scenes, test it on the odd ones."""
    messages: list[str] = []
    render(data, range(HOLDOUT_SEED, HOLDOUT_SEED + scenes), jobs, messages.append)
    yield from messages
    tracker = CadTracker(NetworkEstimator(load_network(weights or WEIGHTS)))
    holdout = measure(tracker, Shards([data, *demos]))
    good = [f for f in holdout.found if np.isfinite(f.position_m)]
    position, rotation = np.array([f.position_m for f in good]) * 1e3, np.rad2deg([f.rotation_rad for f in good])
    yield f"frames with a gripper {holdout.visible}, missed {holdout.missed}, found {len(holdout.found)}"
    yield f"mask IoU          median {np.nanmedian([f.mask_iou for f in good]):.3f}"
    yield f"depth error       median {100 * np.nanmedian([f.depth_error for f in good]):.2f} %"
    yield f"position error    {_spread(position)} mm (median, 90 %, 95 %)"
    yield f"rotation error    {_spread(rotation)} degrees (median, 90 %, 95 %)"
    first, second = (tuple(f for f in holdout.found if f.scene % 2 == odd) for odd in (0, 1))
    tested = calibrate(first)
    probability = np.array([tested.probability_of(f.features) for f in second])
    for mean, share, n in reliability(probability, np.array([f.good for f in second])):
        yield f"confidence {mean:.2f}: within 10 mm and 5 degrees in {share:.2f} of {n} frames"
    if out is not None:
        calibrate(holdout.found).save(out)
        yield f"calibration of all frames written to {out.name}"


def _spread(values: Array) -> str:
    return " ".join(f"{v:.2f}" for v in np.percentile(values, [50, 90, 95]))
