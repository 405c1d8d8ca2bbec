"""`kinebench-drake doctor`."""

import click


@click.command(epilog="\b\nExample:\n  kinebench-drake doctor\n  kinebench-drake doctor --fix")
@click.option(
    "--fix", is_flag=True, help="Repair what can be repaired, in this environment only: no root, no system files."
)
@click.pass_context
def doctor(ctx: click.Context, fix: bool) -> None:
    """Check what works on this machine, and print how to fix what does not.

    The exit status is 0 if everything works (with --fix: works afterwards).
    """
    from kinebench_drake.environment.doctor import render, run_checks
    from kinebench_drake.environment.repair import repair_environment
    from kinebench_drake.runs.benchmark_registry import load_benchmark

    check_rendering = load_benchmark().check
    results = [*run_checks(), check_rendering()]
    click.echo(render(results))
    if fix and repair_environment(results, click.echo):
        results = [*run_checks(), check_rendering()]
        click.echo(render(results))
    ctx.exit(0 if all(check.ok for check in results) else 1)
