"""The command line. Commands load when they are called, so that `--help` answers at once."""

import importlib
import os
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from typing import NoReturn

import click

import kinebench_drake
from kinebench_drake.errors import KinebenchError, UsageError

PROGRAM = "kinebench-drake"

_COMMANDS = {
    "doctor": "Tell what works on this machine and how to fix what does not.",
    "score": "Score videos: gripper tracks, kinematic metrics, report.",
    "ground": "Take gripper tracks from videos, no more.",
    "audit": "Check trajectories against the robot's kinematics, no video.",
    "calibrate": "Find a static camera's place and focal length from the robot it shows.",
    "suite": "Work with the benchmark's task suites.",
    "report": "Write the html report of output folders anew.",
    "compare": "Compare output folders.",
    "merge": "Merge output folders of shards.",
    "view": "Look at one sample in 3D.",
    "perception": "Train and evaluate the perception networks.",
}
"""Names and short helps; a command NAME is the object NAME of the module `kinebench_drake.cli.NAME`."""


class LazyGroup(click.Group):
    """A group that imports a command's module only when the command is called; a command not built yet is absent."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands that exist, in the order of use."""
        return [name for name in _COMMANDS if find_spec(f"{__name__}.{name}") is not None]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name; None if there is none."""
        if cmd_name not in self.list_commands(ctx):
            return None
        command = getattr(importlib.import_module(f"{__name__}.{cmd_name}"), cmd_name)
        return command if isinstance(command, click.Command) else None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, _COMMANDS[name]) for name in self.list_commands(ctx)])


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
    except click.ClickException as error:
        code = _fail(error.format_message(), error.exit_code)
    except UsageError as error:
        code = _fail(str(error), 2)
    except KinebenchError as error:
        code = _fail(str(error), 1)
    except (click.Abort, KeyboardInterrupt):
        code = _fail("interrupted", 130)
    except BrokenPipeError:  # the reader of our output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str, code: int) -> int:
    click.echo(f"{PROGRAM}: {' '.join(message.split())}", err=True)
    return code
