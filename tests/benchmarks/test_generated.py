"""Study of a learned world model: success, and what a person sees beside the results."""

import json

import numpy as np

from benchmarks.footage_labels import read_labels
from benchmarks.generated import choice_lines, gain_text, success_lines
from benchmarks.generated_labels import read_generated_labels
from kinebench_drake.anomaly import AnomalyKind
from kinebench_drake.io.container import write_video
from kinebench_drake.results.row import Status
from tests.rows import make_row


def episode_row(task, seed, success, executable=True, sample=0):
    return make_row(
        id=f"{task}_s{seed:04d}" + (f"_k{sample}" if sample else ""),
        video="a.mp4",
        task=task,
        model="learned",
        status=Status.OK,
        reason=None,
        content_hash="",
        executable=executable,
        metrics={"sparc": -3.0, "manipulability_mean": 0.1, "tracked_fraction": 1.0},
        extra={"success": success, "sample_index": sample},
    )


def write_rows(folder, rows):
    (folder / "samples.jsonl").write_text("".join(json.dumps(row.to_json()) + "\n" for row in rows))
    (folder / "results.json").write_text("{}")


def test_success_is_paired_with_that_of_the_still_video():
    runs = {
        "best": [episode_row(task, seed, success=seed < 8) for task in ("A-v1", "B-v1") for seed in range(10)],
        "still": [episode_row("A-v1", k, success=False) for k in range(10)],
    }
    head, _, best, _ = success_lines(runs)
    assert head.count("|") == best.count("|")
    assert "8 of 10 | 8 of 10 | 80 %" in best
    assert "`still` 80 points" in gain_text(runs)
    assert "(10 episodes)" in gain_text(runs)


def test_choice_takes_the_sample_with_the_best_verdict(tmp_path):
    rows = [
        episode_row("A-v1", seed, success=sample == 1, sample=sample).measured({"executability": 0.5 + 0.1 * sample})
        for seed in range(6)
        for sample in range(2)
    ]
    write_rows(tmp_path, rows)
    first, chosen = choice_lines(tmp_path)[4:]
    assert first.startswith("| the first sample | 0 % | -50 points")
    assert chosen.startswith("| executability | 100 % | 50 points")


def test_the_sample_most_like_the_expert_is_chosen(tmp_path):
    expert = tmp_path / "oracle"
    folder = tmp_path / "samples"
    levels = {expert: (100,), folder: (150, 110)}
    for home, own in levels.items():
        home.mkdir()
        rows = []
        for sample, level in enumerate(own):
            write_video(home / f"{sample}.mp4", np.full((5 - sample, 32, 32, 3), level, np.uint8), 5)
            rows.append(episode_row("A-v1", 0, success=sample == 1, sample=sample).measured({}))
            rows[-1] = rows[-1].extended(video=f"{sample}.mp4")
        write_rows(home, rows)
    assert choice_lines(folder, expert)[6].startswith("| likeness to the expert (PSNR) | 100 % |")


def test_labels_name_known_points_kinds_and_frames():
    labels = read_generated_labels()
    assert read_labels().videos.keys().isdisjoint(labels.videos)
    seen = {kind for clips in labels.anomalies.values() for kinds in clips.values() for kind in kinds}
    assert seen <= {kind.value for kind in AnomalyKind}
    first = {(id, frame.frame) for id, frames in labels.videos.items() for frame in frames}
    assert {(id, frame.frame) for id, frames in labels.again.items() for frame in frames} <= first
    assert all(
        np.isfinite(list(frame.points_px.values())).all() for frames in labels.videos.values() for frame in frames
    )
