"""Errors of motion extraction as the studies of `benchmarks` and `training` write them: records of their files."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from kinebench_drake.errors import UsageError

BASELINE = "baseline.json"
"""File of `python -m training baseline evaluate` in its output folder."""
ROBUSTNESS, DEPTH = "robustness", "depth-ablation"
"""Studies that are drawn."""
LEARNED = "learned"
"""Group of the conditions in which the learned baseline was measured."""
_EXPECTED = (
    f"expected a file of `python -m training baseline evaluate` ({BASELINE}), or of `python -m benchmarks perturb`, "
    "`depth-ablation` or `evaluate` with --json"
)


class Interval(BaseModel):
    """Figure with the ends of its interval; None where there is none."""

    value: float | None
    low: float | None
    high: float | None


class Distribution(BaseModel):
    """Percentiles of the errors of one condition."""

    group: str = ""
    frames: int
    percentiles: tuple[float, ...]
    position_mm: tuple[float, ...] | None
    rotation_deg: tuple[float, ...] | None


class DepthMap(BaseModel):
    """Mean relative depth error over one plane of panda_hand."""

    axes: str
    bounds_mm: tuple[float, float, float, float]
    mean: list[list[float | None]]


class DepthError(BaseModel):
    """Relative error of the estimated depth on the gripper."""

    median: float | None = None
    p95: float | None = None
    maps: dict[str, DepthMap] = {}


class Study(BaseModel):
    """Errors of the grounding on the same videos under several conditions."""

    study: str
    title: str
    videos: list[str]
    conditions: dict[str, dict[str, Interval]]
    distributions: dict[str, Distribution]
    relative_depth_error: DepthError = DepthError()

    @property
    def has_baseline(self) -> bool:
        """True if the learned baseline was measured, too."""
        return any(d.group == LEARNED for d in self.distributions.values())


class PipelineErrors(BaseModel):
    """Errors of one pipeline."""

    pipeline: str
    intervals: dict[str, Interval]
    videos: dict[str, Any]


class BaselineGroup(BaseModel):
    """Errors of the grounding and of the learned baseline on the same videos of one task, or of several."""

    group: str
    trained: bool
    pooled: bool
    videos: int
    tracked_fraction: float
    errors: dict[str, dict[str, tuple[float, float, float]]]
    video_medians: dict[str, dict[str, list[float | None]]]


class Measurements(BaseModel):
    """All files of `perception` that a report was given."""

    names: list[str] = []
    """Names of the files."""
    baseline: list[BaselineGroup] = []
    studies: dict[str, Study] = {}
    evaluations: list[PipelineErrors] = []


def is_measurement(path: Path) -> bool:
    """Return whether a path names a --json file of a study, or the output folder of the learned baseline's."""
    return path.suffix == ".json" or (path / BASELINE).is_file()


def read_measurements(paths: Sequence[Path]) -> Measurements:
    """Read files of `perception`.

    Raises:
        UsageError: a file is no such file, or there are two of one kind.
    """
    files = Measurements()
    for path in paths:
        file = path / BASELINE if path.is_dir() else path
        files.names.append(path.name)
        try:
            content = json.loads(file.read_text(encoding="utf-8"))
            if isinstance(content, list):
                _require_first(file, BASELINE, not files.baseline)
                files.baseline = [BaselineGroup.model_validate(group) for group in content]
            elif isinstance(content, dict) and "distributions" in content:
                study = Study.model_validate(content)
                _require_first(file, study.study, study.study not in files.studies)
                files.studies[study.study] = study
            else:
                files.evaluations.append(PipelineErrors.model_validate(content))
        except (OSError, ValueError, ValidationError):
            raise UsageError(f"{path}: cannot be read; {_EXPECTED} of this version") from None
    return files


def _require_first(file: Path, kind: str, first: bool) -> None:
    if not first:
        raise UsageError(f"{file}: is a second file of {kind}, whose videos would be drawn twice; name one")
