from dataclasses import replace

import pytest
import torch

from benchmarks.runtimes import REFERENCE, RuntimeCost, deviation, figures, runtimes, section
from kinebench_drake.models.panda.robot import RobotPart
from kinebench_drake.models.perception.network import COORDINATE_SCALE_M, PARTS, DenseOutput


@pytest.fixture
def output() -> DenseOutput:
    """Estimates of one image of 4 x 4 cells: background above, an arm link and the hand below."""
    part = torch.full((4, 4), int(RobotPart.BACKGROUND))
    part[2], part[3] = int(RobotPart.LINK0), int(RobotPart.HAND)
    logits = torch.nn.functional.one_hot(part, PARTS).permute(2, 0, 1)[None].float()
    return DenseOutput(logits, torch.zeros(1, 2, 3, 4, 4), torch.zeros(1, 2, 4, 4), *torch.zeros(2, 1, 4, 4))


def test_deviations_are_those_of_the_robot(output: DenseOutput) -> None:
    depth, points, logits = output.log_depth.clone(), output.coordinates.clone(), output.part_logits.clone()
    depth[:, :2], depth[:, 2:] = 1.0, 0.002  # background does not count
    points[:, 1, 0, 2] = 0.03 / COORDINATE_SCALE_M  # of arm cells: the second set
    points[:, 0, 0, 2] = 9.0
    points[:, 0, 0, 3] = 0.03 / COORDINATE_SCALE_M
    logits[..., 0, 0] = logits[..., 3, 0]
    changed = replace(output, log_depth=depth, coordinates=points, part_logits=logits)
    assert deviation(changed, output) == pytest.approx({"labels": 1 / 16, "depth_mm": 2.0, "points_mm": 30.0})
    assert deviation(output, output) == {"labels": 0.0, "depth_mm": 0.0, "points_mm": 0.0}


def test_the_reference_is_among_the_runtimes() -> None:
    name, estimate = next(runtimes(torch.zeros(1, 3, 32, 32), pytest.fail))
    assert name == REFERENCE
    with torch.inference_mode():
        assert estimate(torch.zeros(1, 3, 32, 32)).log_depth.shape == (1, 16, 16)


def test_section_and_figures() -> None:
    cost = RuntimeCost(runtime="fast", size=128, ms=6.25, ratio=0.5, labels=0.0004, depth_mm=3.4, points_mm=0.8)
    assert "| 128 px | fast | 6.2 | 0.50 | 0.04% | 3.40 | 0.80 |" in section([cost])
    assert figures([cost]) == {"fast, 128 px, ms a crop": 6.25}
