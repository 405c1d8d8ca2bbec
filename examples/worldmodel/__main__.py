"""Commands of the learned world model: `python -m examples.worldmodel --help`."""

import logging
from pathlib import Path
from typing import Any

import click

from .pack import write_pack
from .training import TrainConfig, train

FOLDER = click.Path(path_type=Path)
WORK = Path("data/worldmodel")
pack_option = click.option("--pack", type=FOLDER, default=WORK / "pack", help="Folder of the data pack.")


@click.group(context_settings={"help_option_names": ["-h", "--help"], "show_default": True})
def main() -> None:
    """Train and serve a small learned world model."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")


@main.command()
@click.option("--demos", type=FOLDER, required=True, help="Folder that `suite demos` wrote.")
@click.option("--split", type=click.Choice(["train", "test"]), default="train", help="Split the clips are listed as.")
@pack_option
def data(demos: Path, split: str, pack: Path) -> None:
    """Add demonstrations to the data pack.

    \b
    Example:
      kinebench-drake suite demos --suite 3 --split train --episodes 100 --out demos \\
          --tasks OpenBoxEasy-v1,PullCube-v1,StackCube-v1,StoreCube-v2
      python -m examples.worldmodel data --demos demos
    """
    click.echo(f"{write_pack(demos, pack, split)} clips in {pack}")


@main.command("train")
@click.argument("stage", type=click.Choice(["autoencoder", "dynamics"]))
@click.option("--minutes", type=float, required=True, help="Duration of this call [min].")
@click.option("--steps", type=int, default=10**9, help="Step at which training is complete.")
@click.option("--levels", default="", help="Steps at which weights are kept as well, comma-separated.")
@click.option("--demos", type=int, help="Demonstrations of each task.  [default: all]")
@click.option("--cool", is_flag=True, help="Let the learning rate fall in the course of this call.")
@click.option("--seed", type=int, default=0)
@pack_option
@click.option("--out", type=FOLDER, default=WORK / "weights", help="Folder of the weights.")
def train_stage(levels: str, **other: Any) -> None:
    """Train a stage for some minutes; the same command continues a training that was stopped.

    \b
    Example:
      python -m examples.worldmodel train autoencoder --minutes 120
      python -m examples.worldmodel train dynamics --minutes 60 --steps 15000 --levels 1500,4500,7500
    """
    config = TrainConfig(levels=tuple(int(level) for level in levels.split(",") if level), **other)
    click.echo(f"{config.stage}: step {train(config)}, weights in {config.out}")


@main.command()
@click.option("--weights", type=FOLDER, default=WORK / "weights", help="Folder of the weights.")
@click.option("--dynamics", default="dynamics", help="Name of the dynamics' weights: dynamics_01500 for step 1,500.")
@click.option("--port", type=int, default=8000, help="Port; 0: any free one.")
def serve(weights: Path, dynamics: str, port: int) -> None:
    """Serve the model to `suite run --world-model http://127.0.0.1:PORT`."""
    from kinebench_drake.errors import SetupError  # training does not need the package

    from .generator import Generator, make_server

    try:
        server = make_server(Generator(weights, dynamics), port)
    except SetupError as error:
        raise click.ClickException(str(error)) from None
    click.echo(f"listening on http://127.0.0.1:{server.server_port}")
    server.serve_forever()


if __name__ == "__main__":
    main()
