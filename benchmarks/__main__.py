"""`python -m benchmarks`: validation studies and benchmarks."""

from pathlib import Path

import click

from benchmarks import poses, speed, verdicts
from benchmarks.options import EXISTING_FOLDER, FILE, CommandGroup


@click.group(
    cls=CommandGroup,
    epilog="\b\nExample:\n"
    "  python -m benchmarks trajectories make --out tracks --kind infeasible --count 1000 --jobs 2\n"
    "  kinebench-drake audit tracks --out results\n"
    "  python -m benchmarks trajectories check results tracks",
)
def main() -> None:
    """Validation studies and benchmarks; each command has an example."""


for command in (*speed.COMMANDS, *verdicts.COMMANDS, *poses.COMMANDS):
    main.add_command(command)


@main.command(epilog="\b\nExample:\n  python -m benchmarks equivalence results-before results-after")
@click.argument("before", type=EXISTING_FOLDER)
@click.argument("after", type=EXISTING_FOLDER)
def equivalence(before: Path, after: Path) -> None:
    """Compare two output folders of score, audit, ground or suite run; exit 1 if results differ.

    Everything must be byte-equal but for hashes of the code, versions, host, wall times, the wording of messages,
    report.html and replays.
    """
    from benchmarks.equivalence import compare_folders

    result = compare_folders(before, after)
    for line in result.differences:
        click.echo(line)
    click.echo(
        f"{len(result.equal)} files equal, {len(result.uncompared)} not compared, {len(result.differences)} differences"
    )
    if result.differences:
        raise SystemExit(1)


@main.command(epilog="\b\nExample:\n  python -m benchmarks tolerance tolerance.json --out docs/tolerance.png")
@click.argument("source", type=FILE)
@click.option("--out", type=FILE, required=True, help="Image to write.")
def tolerance(source: Path, out: Path) -> None:
    """Draw the JSON that `kinebench-drake suite tolerance` wrote."""
    from benchmarks.tolerance import draw_tolerance

    draw_tolerance(source, out)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks")
