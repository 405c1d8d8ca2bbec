"""Grounding of clips whose camera turns, moves or zooms slowly: unseen scenes of the suites with true poses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.faults.fault_simulator import FaultSimulator
from benchmarks.faults.recording import ViewChange, ViewKind, render_view
from benchmarks.markdown import table
from benchmarks.perception.store import MeasurementStore, fingerprint
from kinebench_drake.camera import benchmark_camera
from kinebench_drake.errors import InputError
from kinebench_drake.geometry import pose_difference
from kinebench_drake.grounding.pipeline import GroundingPipeline
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.npz import open_npz, write_arrays
from kinebench_drake.io.reader import read_video
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.families.registry import find_expert
from kinebench_drake.suites.rollout import render_video, run_expert
from kinebench_drake.suites.seeding import generator

CHANGES = {
    "still": None,
    "turn": ViewChange(kind=ViewKind.TURN, size=10.0),
    "move": ViewChange(kind=ViewKind.MOVE, size=0.1),
    "zoom": ViewChange(kind=ViewKind.ZOOM, size=0.05),
}
"""Changes of the view over a clip, by name."""
_FRAMES = 49
_FPS = 17
_CRF = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewTrial:
    """Errors of the TCP in the base frame over one clip."""

    id: str
    change: str
    """Name of the change."""
    way: str
    """How the camera was followed; empty where it counts as fixed."""
    tracked: float
    """Share of tracked frames."""
    median_m: float
    p95_m: float
    median_rad: float
    silent: float
    """Share of tracked frames that are off by more than 30 mm or 15 degrees."""


def render(spec: EpisodeSpec, name: str, out: Path) -> None:
    """Render the first clip of a spec's expert with a change of view into out.mp4 and out.npz.

    Raises:
        InputError: the expert finds no path.
    """
    episode = spec.episode()
    change = CHANGES[name]
    simulator = FaultSimulator(episode.task, variant=episode.variant)
    try:
        snapshots = run_expert(simulator, find_expert(episode.task), episode).snapshots[:_FRAMES]
        if change is None:
            video = render_video(simulator, snapshots)
        else:
            video = render_view(simulator, snapshots, change, generator("view", episode.id, name))
    finally:
        simulator.close()
    write_video(out.with_suffix(".mp4"), video.rgb, _FPS, crf=_CRF)
    arrays = {"base_from_tcp": video.X_BG, "camera_from_hand": video.X_CH, "t_s": video.t_s}
    write_arrays(out.with_suffix(".npz"), arrays)


def try_clip(id: str, name: str, path: Path, pipeline: GroundingPipeline) -> ViewTrial:
    """Ground a rendered clip and compare it with its true poses."""
    with open_npz(path.with_suffix(".npz")) as truth:
        t_s = truth["t_s"]
        X_BG = truth["base_from_tcp"]
    result = pipeline.ground(read_video(path.with_suffix(".mp4")).frames, benchmark_camera(), t_s)
    tracked = result.track.tracked
    distance, angle = (e[tracked] for e in pose_difference(result.track.X_BG, X_BG))
    median_m, p95_m = np.quantile(distance, (0.5, 0.95)) if tracked.any() else (np.nan, np.nan)
    median_rad = np.median(angle) if tracked.any() else np.nan
    return ViewTrial(
        id=id,
        change=name,
        way=result.camera_path.way.value if result.camera_path is not None else "",
        tracked=float(tracked.mean()),
        median_m=float(median_m),
        p95_m=float(p95_m),
        median_rad=float(median_rad),
        silent=float(((distance > 0.03) | (angle > np.deg2rad(15.0))).mean()) if tracked.any() else 0.0,
    )


def measure(specs: Sequence[EpisodeSpec], names: Sequence[str], out: Path, *, log: Callable[[str], None]) -> str:
    """Render and ground a clip of each episode, with changes of the view in turn; write views.md, and return it.

    Finished clips and measurements are kept in the folder `out`.
    """
    make_folder(out / "clips")
    base = fingerprint(modules=["kinebench_drake.grounding.pipeline"])
    store = MeasurementStore(out / "views.jsonl", ViewTrial)
    pipeline: GroundingPipeline | None = None
    trials = []
    for number, spec in enumerate(specs):
        name = names[number % len(names)]
        path = out / "clips" / f"{spec.id}_{name}"
        try:
            if not path.with_suffix(".npz").is_file():
                render(spec, name, path)
        except InputError as error:
            log(f"{spec.id}: {error}")
            continue
        key = f"{base}-{path.name}"
        if key not in store:
            pipeline = pipeline or GroundingPipeline.create()
            store.put(key, try_clip(spec.id, name, path, pipeline))
            log(_line(store[key]))
        trials.append(store[key])
    text = "\n".join(_table(trials, names)) + "\n"
    write_atomically(out / "views.md", text.encode())
    return text


def _line(t: ViewTrial) -> str:
    return (
        f"{t.id} {t.change}: followed by {t.way or 'nothing'}, tracked {t.tracked:.2f}, median {1e3 * t.median_m:.1f} "
        f"mm {np.rad2deg(t.median_rad):.1f} degrees, 95 % {1e3 * t.p95_m:.1f} mm, silent {t.silent:.2f}"
    )


def _table(trials: Sequence[ViewTrial], names: Sequence[str]) -> list[str]:
    rows = []
    for name in names:
        own = [t for t in trials if t.change == name]
        if own:
            median_m, p95_m, worst_m = (
                1e3 * f([getattr(t, k) for t in own])
                for f, k in ((np.median, "median_m"), (np.median, "p95_m"), (np.max, "median_m"))
            )
            rows.append(
                [
                    name,
                    str(len(own)),
                    str(sum(bool(t.way) for t in own)),
                    f"{np.mean([t.tracked for t in own]):.2f}",
                    f"{median_m:.1f} / {p95_m:.1f}",
                    f"{worst_m:.1f}",
                    f"{np.rad2deg(np.median([t.median_rad for t in own])):.1f}",
                    f"{np.mean([t.silent for t in own]):.3f}",
                ]
            )
    errors = ("TCP median / 95 % [mm]", "worst clip [mm]", "[degrees]", "silent")
    return table(("camera", "clips", "followed", "tracked", *errors), rows)
