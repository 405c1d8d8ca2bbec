"""The same clips with the networks in float32 and in bfloat16: same verdict on camera, frames and anomalies."""

from pathlib import Path

import numpy as np
import pytest

from kinebench_drake.camera import CameraSource
from kinebench_drake.environment.precision import PRECISION_VARIABLE, Precision
from kinebench_drake.formats.videos.find import find_samples
from kinebench_drake.grounding.priors import Clip
from kinebench_drake.grounding.video import Grounder
from kinebench_drake.grounding.video_result import GroundingResult
from kinebench_drake.io.reader import read_video

CLIPS = Path(__file__).parents[1] / "gate"


def ground(name: str, precision: Precision, monkeypatch: pytest.MonkeyPatch) -> GroundingResult:
    (sample,) = [s for s in find_samples(CLIPS / "manifest.jsonl", out=CLIPS / "out").samples if s.id == name]
    frames = read_video(sample.path).frames
    clip = Clip(frames=frames, t_s=(sample.frame_period_s or 0.2) * np.arange(len(frames)))
    monkeypatch.setenv(PRECISION_VARIABLE, precision.value)
    return Grounder().ground(clip, sample.camera, source=CameraSource.MANIFEST)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["benchmark", "g06"])
def test_a_clip_has_the_same_verdict_in_both_precisions(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    single, half = (ground(name, precision, monkeypatch) for precision in Precision)
    assert not np.array_equal(single.track.confidence, half.track.confidence)  # the precisions do differ
    assert single.choice.state is half.choice.state
    assert single.measured.domain is half.measured.domain
    assert single.anomalies == half.anomalies == ()
    assert single.track.tracked.all()
    assert half.track.tracked.all()
