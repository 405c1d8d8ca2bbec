"""Stills with depth and parts, to train the perception networks with: a shard of frames a demonstration.

ID/rgb.npy, ID/depth.npy, ID/part.npy, ID/truth.npz      as `kinebench_drake.models.perception.frame` has them
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kinebench_drake.models.perception.frame import FILES, save_shard
from kinebench_drake.storage import storage
from kinebench_drake.suites.formats.demo import Content, Demo, Record, Shots


class Frames:
    """See the module."""

    content = Content.STILLS

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """The files of a shard."""
        return [folder / record.id / name for name in FILES]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write a shard."""
        with storage(demo.id):
            save_shard(demo.stills, folder / demo.id)

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        """Shards stay as they are."""
        return []

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """None."""
        return []
