"""What a format does: a part for each demonstration as it comes, and the whole when all are there."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from kinebench_drake.io.atomic import disk_errors
from kinebench_drake.models.perception.frame import FILES, save_shard
from kinebench_drake.suites.formats.demo import Content, Demo, FormatKind, Record, Shots


class DemoFormat(Protocol):
    """A format of demonstrations in a folder."""

    content: Content
    """What it holds."""

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Files that a demonstration's part consists of."""

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write a demonstration's part, each file whole or not at all."""

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        """Write what speaks of all demonstrations, given in order; the parts stay.

        Args:
            folder: where.
            records: the demonstrations.
            shots: how they were filmed.
            about: suite, split, pool and variant.

        Returns:
            The files that parts were joined into; none where parts stay as they are.
        """

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Files that `finish` writes beside those it returns."""


def find_format(kind: FormatKind) -> DemoFormat:
    """The format of a name."""
    match kind:
        case FormatKind.MP4:
            from kinebench_drake.suites.formats.videofolder import VideoFolder

            return VideoFolder()
        case FormatKind.LEROBOT:
            from kinebench_drake.suites.formats.lerobot import LeRobot

            return LeRobot()
        case FormatKind.MANISKILL:
            from kinebench_drake.suites.formats.maniskill import ManiSkill

            return ManiSkill()
        case FormatKind.FRAMES:
            return Frames()


class Frames:
    """See the module."""

    content = Content.STILLS

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """The files of a shard."""
        return [folder / record.id / name for name in FILES]

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write a shard."""
        with disk_errors(demo.id):
            save_shard(demo.stills, folder / demo.id)

    def finish(self, folder: Path, records: Sequence[Record], shots: Shots, about: dict[str, Any]) -> list[Path]:
        """Shards stay as they are."""
        return []

    def lists(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """None."""
        return []
