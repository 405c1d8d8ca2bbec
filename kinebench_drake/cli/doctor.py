"""`kinebench-drake doctor`."""

import click


@click.command(epilog="\b\nExample:\n  kinebench-drake doctor\n  kinebench-drake doctor --fix --dry-run")
@click.option(
    "--fix", is_flag=True, help="Repair what can be repaired, in this environment only: no root, no system files."
)
@click.option("--dry-run", is_flag=True, help="With --fix: print the commands, run none.")
@click.pass_context
def doctor(ctx: click.Context, fix: bool, dry_run: bool) -> None:
    """Check what works on this machine, and print how to fix what does not.

    The exit status is 0 if everything works (with --fix: works afterwards).
    """
    from kinebench_drake.environment.doctor import render, run_checks
    from kinebench_drake.environment.repair import repair_environment
    from kinebench_drake.runs.benchmark_registry import load_benchmark

    if dry_run and not fix:
        raise click.UsageError("--dry-run goes with --fix")
    check_rendering = load_benchmark().check
    results = [*run_checks(), check_rendering()]
    click.echo(render(results))
    if fix and repair_environment(results, click.echo, dry_run=dry_run):
        results = [*run_checks(), check_rendering()]
        click.echo(render(results))
    ctx.exit(0 if all(check.ok for check in results) else 1)
