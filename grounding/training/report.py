"""The measurements as lines of text: what `kinebench-drake perception calibrate` and `evaluate` print."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from kinebench_drake.geometry import Array
from kinebench_drake.grounding.confidence import CALIBRATION, Confidence
from kinebench_drake.grounding.estimator import NetworkEstimator
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.grounding.tracker import CadTracker
from kinebench_drake.grounding.training.dataset import Shards
from kinebench_drake.grounding.training.evaluate import ClipErrors, evaluate, load_clips, true_depth_pipeline
from kinebench_drake.grounding.training.holdout import HOLDOUT_SEED, calibrate, measure, reliability
from kinebench_drake.grounding.training.render import render
from kinebench_drake.models.panda.cad import GripperCad
from kinebench_drake.models.perception.weights import WEIGHTS, load_network
from kinebench_drake.products import Anomaly


def holdout_lines(data: Path, weights: Path | None, scenes: int, out: Path | None, jobs: int) -> Iterator[str]:
    """Measure single held-out frames, fit the confidence to the even scenes, test it on the odd ones."""
    messages: list[str] = []
    render(data, range(HOLDOUT_SEED, HOLDOUT_SEED + scenes), jobs, messages.append)
    yield from messages
    tracker = CadTracker(NetworkEstimator(load_network(weights or WEIGHTS)))
    holdout = measure(tracker, Shards(data))
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


def _found(anomalies: Sequence[Anomaly]) -> str:
    return ", ".join(f"{a.kind.value} {a.frame_start}-{a.frame_end}" for a in anomalies) or "-"


def _line(e: ClipErrors) -> str:
    position, rotation = e.position_m * 1e3, np.rad2deg(e.rotation_rad)
    parts = (
        f"{e.id:34s} tracked {e.tracked_fraction:.3f}",
        f"mm {np.nanmedian(position):5.2f} {np.nanpercentile(position, 95):6.2f}",
        f"deg {np.nanmedian(rotation):5.2f} {np.nanpercentile(rotation, 95):6.2f}",
        f"flip {e.longest_flip}  {e.wall_s:4.1f} s",
        f"planted {_found(e.planted)}; found {_found(e.found)}",
    )
    return "  ".join(parts)


def video_lines(
    folder: Path, weights: Path | None, true_depth: bool, limit: int | None, json_out: Path | None
) -> Iterator[str]:
    """Ground the videos of `folder`, a line each, then all frames together.

    Raises:
        UsageError: there is no truth, or no true depth where it is asked for.
    """
    clips = load_clips(folder, with_depth=true_depth)[:limit]
    estimator, cad = NetworkEstimator(load_network(weights or WEIGHTS)), GripperCad()
    confidence = Confidence.load(CALIBRATION)
    base = GroundingPipeline(CadTracker(estimator, cad), confidence)
    base.warm_up()
    yield "median and 95th percentile of position and rotation error of panda_hand; frames are 0-based"
    results: list[ClipErrors] = []
    for clip in clips:
        pipeline = true_depth_pipeline(base, estimator, clip, cad) if true_depth else base
        results.append(evaluate(clip, pipeline))
        yield _line(results[-1])
    summary = summarize(results)
    for key, value in summary.items():
        yield f"{key:32s} {value:.4g}"
    if json_out is not None:
        json_out.write_text(json.dumps(summary, indent=1) + "\n")


def summarize(results: Sequence[ClipErrors]) -> dict[str, float]:
    """Figures over all tracked frames of all videos; planted and found anomalies matched by kind within one frame."""
    position = np.concatenate([e.position_m[e.tracked & e.visible] for e in results]) * 1e3
    rotation = np.rad2deg(np.concatenate([e.rotation_rad[e.tracked & e.visible] for e in results]))
    finger = np.concatenate([e.finger_m for e in results]) * 1e3
    planted = [(e, fault) for e in results for fault in e.planted]
    return {
        "videos": len(results),
        "tracked_fraction": float(np.mean([e.tracked_fraction for e in results])),
        "tracked_fraction_worst": float(min(e.tracked_fraction for e in results)),
        "position_median_mm": float(np.median(position)),
        "position_p95_mm": float(np.percentile(position, 95)),
        "position_max_mm": float(position.max()),
        "rotation_median_deg": float(np.median(rotation)),
        "rotation_p95_deg": float(np.percentile(rotation, 95)),
        "rotation_max_deg": float(rotation.max()),
        "finger_width_median_mm": float(np.nanmedian(finger)),
        "tracked_frames_off_by_3_cm": float((position > 30.0).mean()),
        "longest_flip_frames": max(e.longest_flip for e in results),
        "faults_planted": len(planted),
        "faults_found": sum(any(_same(fault, a) for a in e.found) for e, fault in planted),
        "anomalies_not_planted": sum(not any(_same(f, a) for f in e.planted) for e in results for a in e.found),
        "wall_median_s": float(np.median([e.wall_s for e in results])),
        "wall_max_s": max(e.wall_s for e in results),
    }


def _same(planted: Anomaly, found: Anomaly) -> bool:
    starts, ends = abs(planted.frame_start - found.frame_start), abs(planted.frame_end - found.frame_end)
    # A teleport is found at its jump; the planted range tells how long the gripper stays displaced.
    return planted.kind is found.kind and starts <= 1 and (ends <= 1 or planted.kind.value == "teleport")
