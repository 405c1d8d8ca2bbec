"""Tiled clips in the layouts of published models, made of the example videos, and the panels that are read of them.

Output folder, the same bytes for the same arguments:

    ID.mp4         10 fps
    truth.json     for each clip its panels in reading order: kind, left, top, width, height
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.options import EXAMPLES
from kinebench_drake.grounding.components import GroundingComponents
from kinebench_drake.grounding.panels.panel import PanelKind
from kinebench_drake.grounding.panels.split import split_frames
from kinebench_drake.io.container import write_video
from kinebench_drake.io.reader import read_video
from kinebench_drake.segments import evenly

Film = NDArray[np.uint8]
"""(T, H, W, 3) RGB."""
Places = list[tuple[str, int, int, int, int]]
"""Kind, left, top, width and height of panels."""
FRAMES = 24
_E = PanelKind.EXTERIOR
_W = PanelKind.WRIST
_B = PanelKind.EMPTY
_N = PanelKind.NO_ROBOT
LAYOUTS: Sequence[tuple[int, int, Sequence[Sequence[PanelKind]]]] = (
    (320, 192, ((_E, _E, _W),)),
    (320, 192, ((_E, _E, _W), (_E, _E, _W))),
    (320, 176, ((_W,), (_E, _E))),
    (320, 180, ((_W,), (_E, _E))),
    (384, 216, ((_E, _W), (_E, _B))),
    (320, 256, ((_E, _W),)),
    (256, 256, ((_E, _E),)),
    (224, 224, ((_E,), (_E,))),
    (240, 180, ((_E, _N), (_W, _E))),
)
"""Width and height of a panel [px], and the kinds by rows; a row of one panel is as wide as the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PanelCheck:
    """Panels of one clip, compared with the truth."""

    id: str
    panels: Places
    truth: Places

    @property
    def is_exact(self) -> bool:
        """True if all rectangles are exact, in the same order."""
        return [place[1:] for place in self.panels] == [place[1:] for place in self.truth]

    @property
    def right(self) -> int:
        """Number of panels with exact rectangle and right kind."""
        return len(set(self.panels) & set(self.truth))


def make_clips(out: Path, count: int, seed: int) -> None:
    """Write tiled clips of random layouts, sizes, orders, bars, bands of text and compression."""
    rng = np.random.default_rng(seed)
    films = [np.asarray(read_video(path).frames) for path in sorted(EXAMPLES.glob("*unseen.mp4"))]
    films = [film[evenly(len(film), FRAMES)] for film in films]
    truth = {}
    for k in range(count):
        film, truth[f"tiles_{k:03d}"] = _compose(films, rng)
        write_video(out / f"tiles_{k:03d}.mp4", film, 10, crf=int(rng.integers(14, 31)))
    (out / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


def check_clips(folder: Path) -> Iterator[PanelCheck]:
    """Compare the panels of the clips with the truth."""
    parts = GroundingComponents()
    for id, truth in json.loads((folder / "truth.json").read_text()).items():
        frames = read_video(folder / f"{id}.mp4").frames
        panels = parts.panels(frames, split_frames(frames))
        places = [
            (p.kind.value, p.rectangle.left, p.rectangle.top, p.rectangle.width, p.rectangle.height) for p in panels
        ]
        yield PanelCheck(id=id, panels=places, truth=[(kind, *box) for kind, *box in truth])


def _compose(films: Sequence[Film], rng: np.random.Generator) -> tuple[Film, Places]:
    """Return a tiled film and its panels."""
    width, height, rows = LAYOUTS[int(rng.integers(len(LAYOUTS)))]
    width, height = (4 * round(side * rng.choice([0.75, 1.0, 1.0, 1.25]) / 4) for side in (width, height))
    gap = int(rng.choice([0, 0, 0, 2, 4, 8]))
    paper = int(rng.choice([255, 128] if any(_B in kinds for kinds in rows) else [0, 255, 128]))
    across = max(map(len, rows))
    total = (across * width + gap * (across - 1), len(rows) * height + gap * (len(rows) - 1))
    band = int(rng.choice([0, 0, 28, 40]))
    shift = band * int(rng.integers(2))
    canvas = np.full((FRAMES, total[1] + band, total[0], 3), paper, np.uint8)
    places: Places = []
    order = rng.permutation(len(films))
    columns = rng.permutation(across)
    for r, kinds in enumerate(rows):
        wide = total[0] if len(kinds) == 1 else width
        for c in range(len(kinds)):
            kind = kinds[columns[c] if len(kinds) > 1 else 0]
            film = films[order[(c + r * (len(kinds) == 2)) % len(films)]]
            left = c * (width + gap)
            top = r * (height + gap) + shift
            canvas[:, top : top + height, left : left + wide] = _picture(kind, film, (wide, height), r)
            places.append((kind.value, left, top, wide, height))
    if band:
        top = 0 if shift else total[1]
        ink = (0 if paper == 255 else 255,) * 3
        words = ("Real   Generated", "step 12000", "Put the cube away")[rng.integers(3)]
        for image in canvas:
            cv2.putText(image, words, (12, top + band // 2 + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.5, ink, 1, cv2.LINE_AA)
        places.insert(0 if shift else len(places), ("text", 0, top, total[0], band))
    return canvas, places


def _picture(kind: PanelKind, film: Film, size: tuple[int, int], lag: int) -> Film | int:
    """Return a panel of one kind in a size of (width, height), from its second frame on by `lag` late; 0 for black."""
    if kind is PanelKind.EMPTY:
        return 0
    side = film.shape[2]
    times = np.maximum(np.arange(len(film)) - lag, 0)
    if kind is PanelKind.WRIST:
        return np.stack([_seen_from_hand(film[0], size, 2.0 * np.pi * t / len(film)) for t in times])
    height = min(side, int(side * size[1] / size[0]))
    part = film[:, (side - height) // 3 :][:, :height] if kind is PanelKind.EXTERIOR else film[:, -100:, :100]
    way = cv2.INTER_AREA if size[0] < part.shape[2] else cv2.INTER_LINEAR
    return np.stack([cv2.resize(part[t], size, interpolation=way) for t in times])


def _seen_from_hand(image: Film, size: tuple[int, int], phase: float) -> Film:
    """Return the view of a camera that wanders and turns over an image, with fingers at a fixed place."""
    scale = 1.9 * max(size) / image.shape[1]
    centre = (192.0 + 60.0 * np.sin(phase), 230.0 + 50.0 * np.cos(1.3 * phase))
    M = cv2.getRotationMatrix2D(centre, 40.0 * np.sin(phase) + 20.0, scale)
    M[:, 2] += [size[0] / 2 - centre[0], size[1] / 2 - centre[1]]
    image = image.copy()
    for k in range(30):  # things on the table
        place = (37 * k * k % image.shape[1], 61 * k % image.shape[0])
        cv2.circle(image, place, 6 + k % 7, (11 * k % 256, 255 - 8 * k, 97 * k % 256), -1, cv2.LINE_AA)
    view = cv2.warpAffine(image, M, size, borderMode=cv2.BORDER_REFLECT)
    for x in (0.35, 0.65):
        corners = np.array([[x - 0.05, 1.0], [x, 0.55], [x + 0.04, 0.6], [x + 0.09, 1.0]]) * size
        cv2.fillPoly(view, [corners.round().astype(np.int32)], (40, 38, 45), cv2.LINE_AA)
    return np.asarray(view, np.uint8)
