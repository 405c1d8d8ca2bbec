"""`kinebench-drake doctor`."""

import click


@click.command(epilog="\b\nExample:\n  kinebench-drake doctor\n  kinebench-drake doctor --fix --dry-run")
@click.option(
    "--fix", is_flag=True, help="Mend what can be mended, in this environment alone: no root, no system files."
)
@click.option("--dry-run", is_flag=True, help="With --fix: tell what would change, change nothing.")
@click.pass_context
def doctor(ctx: click.Context, fix: bool, dry_run: bool) -> None:
    """Tell what works on this machine, and how to fix what does not.

    The exit status is 0 if everything works (with --fix: works afterwards).
    """
    from kinebench_drake.environment import doctor as checks
    from kinebench_drake.environment import repair

    if dry_run and not fix:
        raise click.UsageError("--dry-run goes with --fix")
    results = checks.run_checks()
    click.echo(checks.render(results))
    if fix and repair.mend(results, click.echo, dry_run=dry_run):
        results = checks.run_checks()
        click.echo(checks.render(results))
    ctx.exit(0 if all(check.ok for check in results) else 1)
