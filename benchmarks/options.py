"""Options and steps that the commands of benchmarks share."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from benchmarks.markdown import replace_section
from kinebench_drake.cli.click_options import PathParameter
from kinebench_drake.errors import KinebenchError, UsageError, name_options

EXAMPLES = Path("examples/videos")
BASELINE = Path("benchmarks/baseline.safetensors")
"""Weights that `python -m training baseline` made."""
FOLDER = PathParameter(file_okay=False)
FILE = PathParameter(dir_okay=False)
EXISTING_FILE = PathParameter(dir_okay=False, exists=True)
EXISTING_FOLDER = PathParameter(file_okay=False, exists=True)
COUNT = click.IntRange(min=1)

out_option = click.option("--out", type=EXISTING_FILE, help="Markdown page to write a section into.")
work_option = click.option("--work", type=FOLDER, help="Empty folder for input and results, which are kept.")
jobs_option = click.option("--jobs", type=COUNT, default=1, show_default=True, help="Worker processes.")
baseline_option = click.option(
    "--baseline", "weights", type=EXISTING_FILE, default=BASELINE, show_default=True, help="Weights of the baseline."
)
weights_option = click.option(
    "--weights", type=EXISTING_FILE, help="Network weights (safetensors).  [default: those shipped]"
)
log = partial(click.echo, err=True)


class CommandGroup(click.Group):
    """Group whose commands turn errors of the package into errors of the command line."""

    def invoke(self, ctx: click.Context) -> Any:
        """Invoke a command."""
        try:
            return super().invoke(ctx)
        except UsageError as error:
            raise click.UsageError(name_options(str(error))) from None
        except KinebenchError as error:
            raise click.ClickException(name_options(str(error))) from None


def write_section(out: Path | None, text: str) -> None:
    """Print a section and write it into a page."""
    click.echo(text)
    if out is not None:
        out.write_text(replace_section(out.read_text(), text))


@contextmanager
def work_folder(work: Path | None) -> Iterator[Path]:
    """Yield the folder named by --work, created if absent, or else a temporary one."""
    if work is not None:
        work.mkdir(parents=True, exist_ok=True)
        yield work
    else:
        with TemporaryDirectory() as folder:
            yield Path(folder)


def one_thread() -> None:
    """Let numeric libraries use one thread; to be called before NumPy is loaded."""
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))
