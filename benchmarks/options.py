"""Options and steps that the commands of benchmarks share."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from benchmarks.markdown import replace_section
from kinebench_drake.errors import KinebenchError, UsageError

EXAMPLES = Path("examples/videos")
BASELINE = Path("benchmarks/baseline.safetensors")
"""Weights that `python -m benchmarks baseline` made."""
FOLDER = click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, dir_okay=False)
EXISTING_FILE = click.Path(path_type=Path, dir_okay=False, exists=True)
EXISTING_FOLDER = click.Path(path_type=Path, file_okay=False, exists=True)
COUNT = click.IntRange(min=1)

out_option = click.option("--out", type=EXISTING_FILE, help="Markdown page to write a section into.")
work_option = click.option("--work", type=FOLDER, help="Empty folder for input and results, which are kept.")
jobs_option = click.option("--jobs", type=COUNT, default=1, show_default=True, help="Worker processes.")
baseline_option = click.option(
    "--baseline", "weights", type=EXISTING_FILE, default=BASELINE, show_default=True, help="Weights of the baseline."
)
log = partial(click.echo, err=True)


@contextmanager
def errors() -> Iterator[None]:
    """Turn errors of the package into errors of the command line."""
    try:
        yield
    except UsageError as error:
        raise click.UsageError(str(error)) from None
    except KinebenchError as error:
        raise click.ClickException(str(error)) from None


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
