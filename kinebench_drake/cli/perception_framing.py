"""`kinebench-drake perception framing`."""

import click

from kinebench_drake.cli.perception_evaluate import Measuring, measuring, write_json

_TERMS = """\b
scaled     the picture in another size
letterbox  the whole picture, black bars beside it
crop       the middle of the picture, as much as fills the video
stretch    the picture drawn out of shape

"""
"""What the words of the table mean."""


@click.command(epilog=_TERMS + "\b\nExample:\n  kinebench-drake perception framing heldout --limit 6")
@measuring
def framing(order: Measuring) -> None:
    """Measure the same videos in the sizes of video models: 832x480, 720x480 and 512x512, made in every usual way.

    What was done is found out from each video's first frame and undone, as `score` does it.
    """
    from kinebench_drake.grounding.evaluation import study

    write_json(order.json_out, order.compare(study.framing()).to_json())
