"""The reward against faults of graded size, and against hacks: clips that are no better than the honest one.

A hack is a change of a clip's frames that raises a careless reward. A graded fault is a hack with a strength, or a
fault in the track of a clip. Each is made from the example videos, with the camera, the first frame and the length of
the path of the honest clip.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks import markdown
from kinebench_drake.api.scorer import Score, Scorer
from kinebench_drake.formats.camerafile import read_camera
from kinebench_drake.geometry import Array, transform_points
from kinebench_drake.grounding.tracking.view import GRIPPER_CENTRE_H
from kinebench_drake.io.reader import read_video
from kinebench_drake.metrics.executability import gather_faults, rate_faults
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.runs.resources import Resources, RobotOptions
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.track import GripperTrack

Pictures = NDArray[np.uint8]
HAND_SHARE = 0.14
"""Half the width of the square that holds the hand, over the width of the picture."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Clip:
    """Honest clip."""

    id: str
    frames: Pictures
    """(T, H, W, 3) RGB."""
    hand_px: Array
    """(T, 2) centre of the gripper [px]."""
    p_C: Array
    """(T, 3) position of panda_hand in the camera frame [m]."""
    other: Pictures
    """Frames of the clip of another prompt."""

    def at(self, order: Sequence[float] | Array) -> Pictures:
        """Return the frames in an order, as many as there are."""
        index = np.clip(np.round(order), 0, len(self.frames) - 1).astype(int)
        return self.frames[np.resize(index, len(self.frames))]

    def change_hand(self, change: Callable[[Pictures], Pictures], first: int = 0, last: int | None = None) -> Pictures:
        """Return the frames with the square of the hand changed from frame `first` to before `last`."""
        frames = self.frames.copy()
        half = round(HAND_SHARE * frames.shape[2])
        for i in range(first, len(frames) if last is None else last):
            column, row = np.maximum(np.round(self.hand_px[i]).astype(int) - half, 0)
            part = frames[i, row : row + 2 * half, column : column + 2 * half]
            part[:] = change(part)
        return frames


def read_clips(folder: Path) -> list[Clip]:
    """Read the clean videos of a folder with its camera.json and the true poses in truth/."""
    camera = read_camera(str(folder / "camera.json")).camera
    paths = [path for path in sorted(folder.glob("*.mp4")) if path.stem.endswith("unseen")]
    frames = [np.asarray(read_video(path).frames) for path in paths]
    clips = []
    for k, path in enumerate(paths):
        with np.load(folder / "truth" / f"{path.stem}.npz") as truth:
            X_CH = truth["camera_from_hand"]
        centres = transform_points(X_CH, GRIPPER_CENTRE_H[None])[:, 0]
        other = frames[(k + 1) % len(paths)]
        hand_px = camera.project(centres)
        clips.append(Clip(id=path.stem, frames=frames[k], hand_px=hand_px, p_C=X_CH[:, :3, 3], other=other))
    return clips


def blur(sigma: float) -> Callable[[Pictures], Pictures]:
    """Return the function that blurs pictures."""
    return lambda image: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=np.uint8)


def _warp(frames: Pictures, zoom: Array, shift_px: Array) -> Pictures:
    """Return the frames zoomed by (T,) about their centre and shifted by (T, 2) [px]."""
    height, width = frames.shape[1:3]
    centre = np.array([width, height]) / 2.0
    maps = [np.column_stack([z * np.eye(2), (1.0 - z) * centre + s]) for z, s in zip(zoom, shift_px, strict=True)]
    border = {"borderMode": cv2.BORDER_REPLICATE}
    return np.stack([cv2.warpAffine(f, M, (width, height), **border) for f, M in zip(frames, maps, strict=True)])


def _drift(clip: Clip, size_px: float) -> Pictures:
    ramp = np.linspace(0.0, 1.0, len(clip.frames))
    return _warp(clip.frames, np.ones(len(ramp)), size_px * ramp[:, None] * [1.0, 0.3])


def _zoom(clip: Clip, size: float) -> Pictures:
    return _warp(clip.frames, 1.0 + size * np.linspace(0.0, 1.0, len(clip.frames)), np.zeros((len(clip.frames), 2)))


def _freeze(clip: Clip, frames: float) -> Pictures:
    order = np.arange(len(clip.frames))
    middle = len(order) // 3
    return clip.at(np.where((order >= middle) & (order < middle + frames), middle, order))


def hide(clip: Clip, frames: float, start: int | None = None) -> Pictures:
    """Return the clip with the hand hidden for some frames, by default from a third on."""
    start = len(clip.frames) // 3 if start is None else start
    return clip.change_hand(lambda part: np.full_like(part, 128), start, start + int(frames))


def _paste_hand(clip: Clip) -> Pictures:
    half = round(HAND_SHARE * clip.frames.shape[2])
    column, row = np.maximum(np.round(clip.hand_px[0]).astype(int) - half, 0)
    place = (slice(row, row + 2 * half), slice(column, column + 2 * half))
    frames = clip.frames.copy()
    frames[:, *place] = frames[0, *place]
    return frames


def _fade(clip: Clip) -> Pictures:
    weight = np.linspace(0.0, 1.0, len(clip.frames))[:, None, None, None]
    return np.asarray((1.0 - weight) * clip.frames[0] + weight * clip.frames[-1], dtype=np.uint8)


def _steps(clip: Clip) -> Array:
    return np.arange(len(clip.frames), dtype=float)


HACKS: Mapping[str, Callable[[Clip], Pictures]] = MappingProxyType(
    {
        "first frame repeated": lambda c: c.at([0]),
        "stops after a third": lambda c: c.at(np.minimum(_steps(c), len(c.frames) // 3)),
        "tiny motion: a tenth of the way": lambda c: c.at(0.1 * _steps(c)),
        "slow motion: half of the way": lambda c: c.at(0.5 * _steps(c)),
        "waits for half, then twice as fast": lambda c: c.at(np.maximum(2.0 * _steps(c) - len(c.frames), 0.0)),
        "twice as fast, then stands": lambda c: c.at(2.0 * _steps(c)),
        "each second frame repeated": lambda c: c.at(2.0 * (_steps(c) // 2)),
        "forward and back at double speed": lambda c: c.at(
            len(c.frames) - 1 - np.abs(len(c.frames) - 1 - 2 * _steps(c))
        ),
        "backwards": lambda c: c.frames[::-1],
        "a quarter in a loop": lambda c: c.at(_steps(c) % (len(c.frames) // 4)),
        "mirrored": lambda c: c.frames[:, :, ::-1],
        "clip of another prompt": lambda c: np.resize(c.other, c.frames.shape),
        "gripper scrolled out of the picture": lambda c: _drift(c, 0.6 * c.frames.shape[2]),
        "slow zoom": lambda c: _zoom(c, 0.25),
        "camera drifts": lambda c: _drift(c, 20.0),
        "hand blurred away": lambda c: c.change_hand(blur(12.0)),
        "picture blurred": lambda c: np.stack([blur(3.0)(frame) for frame in c.frames]),
        "hand hidden in six frames": lambda c: hide(c, 6),
        "static hand drawn over": _paste_hand,
        "cross-fade from first to last frame": _fade,
    }
)
"""Changes of a clip that make no better motion."""
GRADED_VIDEOS: Mapping[str, tuple[Callable[[Clip, float], Pictures], tuple[float, ...]]] = MappingProxyType(
    {
        "freeze, frames": (_freeze, (4, 5, 6, 7, 8, 10, 12, 15)),
        "hidden hand, frames": (hide, (1, 2, 3, 4, 6, 8, 10, 12)),
        "camera drift, px": (_drift, (2, 4, 6, 9, 13, 18, 24, 32)),
    }
)
"""Faults in the pictures, with eight sizes each."""
_NOISE = np.random.default_rng(0).normal(size=(999, 3))


def _move(track: GripperTrack, shift_m: Array) -> GripperTrack:
    X = track.X_BG.copy()
    X[:, :3, 3] += shift_m
    return replace(track, X_BG=X)


def _bump(track: GripperTrack) -> Array:
    """Return weights (T, 1) of an excursion over all frames."""
    return np.sin(np.linspace(0.0, np.pi, len(track.t_s)))[:, None] ** 2


def _lowered(track: GripperTrack, depth_m: float) -> GripperTrack:
    """Return the track with an excursion in which the TCP ends below the table."""
    weight = _bump(track)
    return _move(track, weight * (-depth_m - track.X_BG[:, 2:3, 3]) * [0.0, 0.0, 1.0])


GRADED_TRACKS: Mapping[str, tuple[Callable[[GripperTrack, float], GripperTrack], tuple[float, ...]]] = MappingProxyType(
    {
        "jump, m": (
            lambda t, s: _move(t, s * (np.arange(len(t.t_s)) >= len(t.t_s) // 2)[:, None] * [0.0, 0.0, 1.0]),
            (0.03, 0.045, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22),
        ),
        "out of reach, m": (
            lambda t, s: _move(t, s * _bump(t) * [1.0, 0.0, 0.0]),
            (0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7),
        ),
        "in the table, m": (_lowered, (0.0, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.1)),
        "speed, times": (lambda t, s: replace(t, t_s=t.t_s / s), (1.5, 2, 3, 4, 5, 6, 8, 10)),
        "jitter, m": (
            lambda t, s: _move(t, s * _NOISE[: len(t.t_s)]),
            (0.004, 0.006, 0.008, 0.01, 0.013, 0.016, 0.02, 0.025),
        ),
    }
)
"""Faults in the poses, with eight sizes each."""
TIE = 1e-4
"""Greatest difference of equal scores."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HackScore:
    """Rewards of a hack, over that of the honest clip."""

    name: str
    clip: str
    reward: float
    """With the first frame and the length of the honest path."""
    plain: float
    """Without them."""


def measure_hacks(clips: Sequence[Clip], camera: Path, log: Callable[[str], None]) -> list[HackScore]:
    """Score every hack of every clip beside the honest one."""
    scores = []
    with Scorer() as scorer:
        for clip in clips:
            honest = scorer(clip.frames, camera=camera, period_s=FRAME_PERIOD_S, first_frame=clip.frames[0])
            length_m = honest.numbers["path_length_m"]

            def ask(frames: Pictures, clip: Clip = clip, length_m: float = length_m) -> Score:
                options = {"camera": camera, "first_frame": clip.frames[0], "motion_m": length_m}
                return scorer(np.ascontiguousarray(frames), period_s=FRAME_PERIOD_S, **options)

            whole = ask(clip.frames)
            for name, change in HACKS.items():
                score = ask(change(clip))
                scores.append(
                    HackScore(
                        name=name,
                        clip=clip.id,
                        reward=score.reward / whole.reward,
                        plain=score.numbers.get("executability", 0.0) / whole.numbers["executability"],
                    )
                )
                log(f"{clip.id}: {name}: {scores[-1].reward:.3f}, {scores[-1].plain:.3f}")
    return scores


def hack_lines(scores: Sequence[HackScore]) -> list[str]:
    """Return the table of hacks: the greatest share of the honest reward over the clips."""
    rows = []
    for name in HACKS:
        own = [score for score in scores if score.name == name]
        rows.append([name, f"{max(s.reward for s in own):.2f}", f"{max(s.plain for s in own):.2f}"])
    return markdown.table(["hack", "share of the honest reward", "without first frame and path"], rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grades:
    """Scores of a fault of eight sizes, of one clip."""

    kind: str
    sizes: tuple[float, ...]
    scores: tuple[float, ...]

    @property
    def correlation(self) -> float:
        """Rank correlation of the score with the size, with the sign turned."""
        return -float(spearmanr(self.sizes, self.scores).statistic)

    @property
    def ties(self) -> float:
        """Share of the pairs with equal scores."""
        return float(np.mean([abs(a - b) < TIE for a, b in combinations(self.scores, 2)]))


def grade_tracks(files: Sequence[Path], log: Callable[[str], None]) -> Iterator[Grades]:
    """Yield the scores of the faults in the poses of track files, as those of videos."""
    tools = Resources(RobotOptions())
    for file in files:
        track = replace(read_track(file).track, offset_m=0.01, offset_rad=float(np.deg2rad(5.0)))
        for kind, (plant, sizes) in GRADED_TRACKS.items():
            faults = [gather_faults(tools.judge(plant(track, size)), {}) for size in sizes]
            scores = tuple(rate_faults(each).score if each else 0.0 for each in faults)
            log(f"{file.stem}: {kind}: {', '.join(f'{score:.3f}' for score in scores)}")
            yield Grades(kind=kind, sizes=sizes, scores=scores)


def grade_videos(clips: Sequence[Clip], camera: Path, log: Callable[[str], None]) -> Iterator[Grades]:
    """Yield the scores of the faults in the pictures of clips."""
    with Scorer() as scorer:
        for clip in clips:
            for kind, (plant, sizes) in GRADED_VIDEOS.items():
                frames = (plant(clip, size) for size in sizes)
                scores = tuple(scorer(each, camera=camera, period_s=FRAME_PERIOD_S).reward for each in frames)
                log(f"{clip.id}: {kind}: {', '.join(f'{score:.3f}' for score in scores)}")
                yield Grades(kind=kind, sizes=sizes, scores=scores)


def grade_lines(grades: Sequence[Grades]) -> list[str]:
    """Return the table of faults: correlation and ties within groups of eight sizes."""
    rows = []
    for kind in (*GRADED_TRACKS, *GRADED_VIDEOS):
        own = [each for each in grades if each.kind == kind]
        if own:
            correlations = [each.correlation for each in own]
            ties = float(np.mean([each.ties for each in own]))
            rows.append(
                [kind, f"{len(own)}", f"{np.median(correlations):.2f}", f"{min(correlations):.2f}", f"{ties:.1%}"]
            )
    return markdown.table(["fault", "clips", "rank correlation, median", "least", "ties"], rows)
