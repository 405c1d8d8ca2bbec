"""`kinebench-drake doctor`."""

import click


@click.command(epilog="\b\nExample:\n  kinebench-drake doctor")
@click.pass_context
def doctor(ctx: click.Context) -> None:
    """Tell what works on this machine, and how to fix what does not."""
    from kinebench_drake import doctor as checks

    results = checks.run_checks()
    click.echo(checks.render(results))
    ctx.exit(0 if all(check.ok for check in results) else 1)
