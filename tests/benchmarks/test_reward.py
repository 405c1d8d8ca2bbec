"""Hacks and graded faults: each changes a clip, none its shape; the tables count correlations and ties."""

import numpy as np
import pytest

from benchmarks.options import EXAMPLES
from benchmarks.reward import (
    GRADED_TRACKS,
    GRADED_VIDEOS,
    HACKS,
    Grades,
    HackScore,
    grade_lines,
    hack_lines,
    read_clips,
)


@pytest.fixture(scope="module")
def clips():
    return read_clips(EXAMPLES)


def test_there_are_twenty_hacks_and_eight_faults_of_eight_sizes():
    assert len(HACKS) == 20
    kinds = {**GRADED_TRACKS, **GRADED_VIDEOS}
    assert len(kinds) == 8
    assert {len(sizes) for _, sizes in kinds.values()} == {8}


def test_every_hack_changes_a_clip_and_keeps_its_shape(clips):
    for name, change in HACKS.items():
        frames = change(clips[0])
        assert (frames.shape, frames.dtype) == (clips[0].frames.shape, np.uint8), name
        assert (frames != clips[0].frames).any(), name
    for name, (change, sizes) in GRADED_VIDEOS.items():
        assert (change(clips[0], sizes[0]) != change(clips[0], sizes[-1])).any(), name


def test_the_tables_count_the_worst_share_and_the_ties():
    grades = Grades(kind="jump, m", sizes=(1.0, 2.0, 3.0), scores=(0.9, 0.5, 0.5))
    assert grades.ties == pytest.approx(1 / 3)
    assert grade_lines([grades])[2] == "| jump, m | 1 | 0.87 | 0.87 | 33.3% |"
    scores = [HackScore(name=name, clip="a", reward=0.5, plain=1.0) for name in HACKS]
    assert hack_lines(scores)[2] == "| first frame repeated | 0.50 | 1.00 |"
