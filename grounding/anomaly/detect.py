"""All anomaly detectors applied to a video."""

from dataclasses import replace

import numpy as np

from kinebench_drake.grounding.anomaly.camera_motion import find_camera_motion
from kinebench_drake.grounding.anomaly.detection import AnomalyDetections, Detection
from kinebench_drake.grounding.anomaly.duplicate import find_duplicates
from kinebench_drake.grounding.anomaly.evidence import Evidence
from kinebench_drake.grounding.anomaly.freeze import find_freezes
from kinebench_drake.grounding.anomaly.jumps import find_finger_faults, find_teleports
from kinebench_drake.grounding.anomaly.shape import find_deformations, find_scale_drift
from kinebench_drake.grounding.anomaly.vanish import find_vanishing


def find_anomalies(seen: Evidence) -> AnomalyDetections:
    """Ask every detector; the jump that ends a freeze is part of it, no teleport."""
    freezes = find_freezes(seen.p_C, seen.fair, seen.still, seen.t_s)
    found = (
        find_vanishing(seen.p_C, seen.confidence, seen.explained, seen.fair, seen.camera),
        find_duplicates(seen.other),
        _without(find_teleports(seen.p_C, seen.fair, seen.good), {a.frame_end + 1 for a in freezes.anomalies}),
        freezes,
        find_deformations(seen.misfit, seen.residual),
        find_scale_drift(seen.scale),
        find_camera_motion(seen.motion),
        find_finger_faults(seen.finger_width_m, seen.t_s),
    )
    return AnomalyDetections(findings={finding.kind: finding for finding in found})


def _without(finding: Detection, frames: set[int]) -> Detection:
    """A finding without its anomalies that begin in, or next to, some frames."""
    score, near = finding.score.copy(), {f + d for f in frames for d in (-1, 0, 1)}
    score[[f for f in near if 0 <= f < len(score)]] = 0.0
    return replace(
        finding,
        score=np.asarray(score),
        anomalies=tuple(a for a in finding.anomalies if a.frame_start not in near),
    )
