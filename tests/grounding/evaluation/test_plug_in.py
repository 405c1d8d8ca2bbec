"""Depth estimators of others in the depth ablation: the pipeline gets their depth, as an estimate."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kinebench_drake.errors import UsageError
from kinebench_drake.grounding.evaluation.clip import TruthClip
from kinebench_drake.grounding.evaluation.variants import plug_in
from kinebench_drake.types import Priors

CLASS = """
class Ramp:
    def depth(self, frames, camera):
        return 0.5 + frames[..., 1] / 100 + 0 * camera.rays()[..., 0]
"""


def test_the_pipeline_gets_the_depth_of_a_class(
    clip: TruthClip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a_ramp_of_mine.py").write_text(CLASS)
    monkeypatch.syspath_prepend(tmp_path)
    calls = list[Priors]()
    shipped = SimpleNamespace(ground=lambda frames, camera, t_s, priors: calls.append(priors))
    frames = np.random.default_rng(0).integers(0, 255, (5, 192, 192, 3), dtype=np.uint8)  # other than the camera
    plug_in("a_ramp_of_mine:Ramp")(SimpleNamespace(shipped=shipped), clip, frames)  # type: ignore[arg-type]
    (priors,) = calls
    assert priors.depth is not None
    assert not priors.depth.exact
    np.testing.assert_allclose(priors.depth.depth_m, 0.5 + frames[..., 1] / 100)
    assert (priors.mask, priors.X_CH, priors.initial_state) == (None, None, None)


def test_an_estimator_that_is_not_there_is_told_before_anything_is_measured() -> None:
    with pytest.raises(UsageError, match="no module"):
        plug_in("no_such_module:Depth")
