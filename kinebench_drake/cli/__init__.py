"""The command line. Commands are imported when they are called, so that `--help` answers at once."""

import importlib
import os
import sys
from collections.abc import Sequence
from typing import NoReturn, cast

import click

import kinebench_drake
from kinebench_drake.errors import KinebenchError, UsageError, name_options, one_line, suggestion
from kinebench_drake.executors.interrupt import ignore_interrupts

PROGRAM = "kinebench-drake"

_COMMANDS = {
    "doctor": ("doctor", "Check this machine and say how to fix what does not work."),
    "score": ("score", "Score videos: gripper tracks, kinematic metrics, report."),
    "ground": ("score", "Extract gripper tracks from videos, without kinematics."),
    "audit": ("score", "Check trajectories against the robot's kinematics, without video."),
    "follow": ("score", "Compare videos with the actions, or the real clips, that they should show."),
    "reading": ("score", "Print how a trajectory file would be read."),
    "export-commands": ("score", "Write the commands with which a robot executes a trajectory."),
    "calibrate": ("calibrate", "Estimate a static camera from a video of the robot."),
    "cameras": ("calibrate", "List the cameras that are known by name."),
    "robots": ("calibrate", "List the arms that are known by name, and what is checked of each."),
    "serve": ("serve", "Score clips that are sent over HTTP."),
    "suite": ("", "Task suites: closed-loop runs, demonstrations, exports, reports."),
    "report": ("outputs", "Write the html report of output folders again."),
    "compare": ("outputs", "Compare output folders."),
    "merge": ("outputs", "Merge output folders of shards."),
    "view": ("outputs", "Show one sample in 3D."),
    "bundle": ("publish", "Pack the results of a run into one file."),
    "verify": ("publish", "Check whether the numbers of a bundle hold."),
    "leaderboard": ("publish", "Rank the models of bundles on a static page."),
}
"""Command name to (module in `kinebench_drake.cli`, short help); the command is the module's object of that name,
with underscores. That of the benchmark comes from its registry."""

_HINTS = {
    "--fps": "the time between two frames is --frame-period SECONDS (1 / fps), of `audit` --rate HZ",
}
"""Options that other programs have: what to use."""


class LazyGroup(click.Group):
    """A group that imports the module of a command when the command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands, in the order of use."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command, or None if the name is unknown."""
        if cmd_name not in _COMMANDS:
            return None
        if cmd_name == "suite":
            from kinebench_drake.runs.benchmark_registry import load_benchmark

            return load_benchmark().commands()
        module = importlib.import_module(f"{__name__}.{_COMMANDS[cmd_name][0]}")
        return cast(click.Command, getattr(module, cmd_name.replace("-", "_")))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command of the arguments; of an unknown one, name the most similar."""
        if args[0] not in _COMMANDS and not args[0].startswith("-"):
            ctx.fail(f"no command {args[0]!r}{suggestion(args[0], _COMMANDS)}; there are {', '.join(_COMMANDS)}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, short_help) for name, (_, short_help) in _COMMANDS.items()])


@click.group(
    cls=LazyGroup,
    epilog="\b\nExample:\n  kinebench-drake score videos/ --out results/",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(kinebench_drake.__version__, prog_name=PROGRAM)
def cli() -> None:
    """Judge robot videos by geometry: gripper tracks and Drake kinematics."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the program and exit: 0 when it finished, 1 when nothing came of it, 2 for a usage error."""
    try:
        code = cli.main(args=arguments, prog_name=PROGRAM, standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        code = 2
    except click.NoSuchOption as error:
        hint = _HINTS.get(error.option_name)
        code = _fail(f"no option {error.option_name}: {hint}" if hint else error.format_message(), error.exit_code)
    except click.MissingParameter as error:
        command = PROGRAM if error.ctx is None else error.ctx.command_path
        code = _fail(f"{error.format_message()} `{command} --help` lists what it takes", error.exit_code)
    except click.ClickException as error:
        code = _fail(error.format_message(), error.exit_code)
    except UsageError as error:
        code = _fail(str(error), 2)
    except KinebenchError as error:
        code = _fail(str(error), 1)
    except (click.Abort, KeyboardInterrupt):
        ignore_interrupts()
        code = _fail("interrupted", 130)
    except BrokenPipeError:  # the reader of our output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int) -> int:
    click.echo(f"{PROGRAM}: {one_line(name_options(message))}", err=True)
    return code
