"""`kinebench-drake perception anomalies`."""

from pathlib import Path

import click

from kinebench_drake.cli.perception_evaluate import check_figure, write_json

_FOLDER = click.Path(path_type=Path, exists=True, file_okay=False)


@click.command(
    epilog="\b\nframes right           found with its start (and end, where it has one) where it was planted\n"
    "found                  found anywhere in the video\n"
    "area under the curve   how often a faulty video scores above a clean one; 95 % interval after Newcombe (2006)\n\n"
    "\b\nExample:\n"
    "  kinebench-drake suite demos --suite 2 --split unseen --episodes 5 --out clean\n"
    "  python -m benchmarks.planted_videos --suite 2 --split unseen --out faulty\n"
    "  kinebench-drake perception anomalies clean faulty --json anomalies.json --figure anomalies.png"
)
@click.argument("clean", type=_FOLDER)
@click.argument("faulty", type=_FOLDER)
@click.option(
    "--weights", type=click.Path(path_type=Path, dir_okay=False, exists=True), default=None,
    help="Weights to measure (safetensors).  [default: those shipped]",
)  # fmt: skip
@click.option("--limit", type=click.IntRange(1), help="So many clean videos, and of each fault, tasks in turn.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Worker processes.")
@click.option(
    "--json", "json_out", type=click.Path(path_type=Path, dir_okay=False),
    help="Write the figures here; what is finished is kept in NAME.clips.jsonl beside it.",
)  # fmt: skip
@click.option("--figure", type=click.Path(path_type=Path, dir_okay=False), help="Draw the figure (png).")
def anomalies(
    clean: Path, faulty: Path, weights: Path | None, limit: int | None, jobs: int, json_out: Path | None,
    figure: Path | None,
) -> None:  # fmt: skip
    """Measure how well planted anomalies are found, and how often there are false alarms.

    CLEAN is what `suite demos` writes, FAULTY what `python -m benchmarks.planted_videos` writes.
    """
    from kinebench_drake.cli.run import ProgressView
    from kinebench_drake.executors.base import ExecutorKind, create_executor
    from kinebench_drake.grounding.evaluation.anomalies import find_cases, measure
    from kinebench_drake.grounding.evaluation.anomaly_table import table_json, table_lines

    check_figure(figure)
    cases = find_cases(clean, faulty, limit)
    keep = json_out.with_suffix(".clips.jsonl") if json_out else None
    with ProgressView("videos") as view:
        findings = measure(cases, weights, create_executor(ExecutorKind.LOCAL, jobs), view, keep)
    for line in table_lines(findings):
        click.echo(line)
    write_json(json_out, table_json(findings))
    if figure:
        from kinebench_drake.grounding.evaluation.anomaly_table import draw_anomalies
        from kinebench_drake.io.figure import save

        save(draw_anomalies(findings), figure)
