"""Commands that measure the gate of data sets, sweeps past obstacles and exported commands."""

from pathlib import Path

import click

from benchmarks.options import COUNT, EXISTING_FOLDER, jobs_option, out_option, work_folder, work_option, write_section

_seed_option = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)


@click.command(epilog="\b\nExample:\n  python -m benchmarks drops --jobs 2 --out docs/gate.md")
@click.option("--count", type=COUNT, default=210, show_default=True, metavar="N")
@_seed_option
@jobs_option
@work_option
@out_option
def drops(count: int, seed: int, jobs: int, work: Path | None, out: Path | None) -> None:
    """Audit a data set with planted faults and compare its drop list with them."""
    from benchmarks.drops import draw_episodes, score_list, write_dataset
    from benchmarks.markdown import section
    from kinebench_drake.runs.audit import AuditConfig, audit_trajectories

    episodes = list(draw_episodes(count, seed))
    with work_folder(work) as folder:
        write_dataset(folder / "dataset", episodes)
        config = AuditConfig(source=folder / "dataset", out=folder / "out", replays=0, jobs=jobs)
        lines = score_list(episodes, audit_trajectories(config).drops, count)
    write_section(out, section("Planted faults", lines))


@click.command(epilog="\b\nExample:\n  python -m benchmarks sweeps --out docs/validation.md")
@click.option("--count", type=COUNT, default=1000, show_default=True, metavar="N")
@click.option("--samples", type=COUNT, default=50, show_default=True, help="Postures between two frames.", metavar="N")
@_seed_option
@out_option
def sweeps(count: int, samples: int, seed: int, out: Path | None) -> None:
    """Compare contacts with obstacles by sweeps with those of dense sampling."""
    from benchmarks.markdown import section
    from benchmarks.sweeps import compare

    write_section(out, section("Obstacles between frames", compare(count, samples, seed)))


@click.command(epilog="\b\nExample:\n  python -m benchmarks commands --out docs/validation.md")
@click.option("--count", type=COUNT, default=200, show_default=True, metavar="N")
@_seed_option
@work_option
@out_option
def commands(count: int, seed: int, work: Path | None, out: Path | None) -> None:
    """Export tracks as commands and compare finite differences of the files with the robot's limits."""
    from benchmarks.commands import export_all
    from benchmarks.markdown import section

    with work_folder(work) as folder:
        write_section(out, section("Commands", export_all(folder, count, seed)))


@click.command(epilog="\b\nExample:\n  python -m benchmarks recorded RoboWM-Bench/replay_json --jobs 2")
@click.argument("source", type=EXISTING_FOLDER)
@click.option("--count", type=COUNT, help="Recordings.  [default: all]", metavar="N")
@jobs_option
@work_option
@out_option
def recorded(source: Path, count: int | None, jobs: int, work: Path | None, out: Path | None) -> None:
    """Audit the recorded joint angles of RoboWM-Bench (`replay_json`): time, memory and verdicts."""
    from benchmarks.markdown import section
    from benchmarks.recorded import audit_recordings

    with work_folder(work) as folder:
        write_section(out, section("Recorded tracks", audit_recordings(source, folder, count, jobs)))


COMMANDS = (drops, sweeps, commands, recorded)
