"""Format of demonstrations in a folder: one part per demonstration, joined or indexed at the end."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from kinebench_drake.suites.formats.demo import Content, Demo, FormatKind, Record, RenderOptions


class DemoFormat(Protocol):
    """Writer of demonstrations in one format."""

    content: Content
    """Required content of demonstrations."""

    def part_files(self, folder: Path, record: Record) -> list[Path]:
        """Return the files of a demonstration's part."""

    def write_part(self, folder: Path, demo: Demo) -> None:
        """Write a demonstration's part, each file whole or not at all."""

    def finish(
        self, folder: Path, records: Sequence[Record], options: RenderOptions, about: dict[str, Any]
    ) -> list[Path]:
        """Write the files that concern all demonstrations; the parts are kept.

        Args:
            folder: output folder.
            records: the demonstrations, in order.
            options: options of rendering.
            about: suite, split, pool and variant.

        Returns:
            The files into which parts were joined; none for formats that keep their parts.
        """

    def index_files(self, folder: Path, tasks: Sequence[str]) -> list[Path]:
        """Return the files that `finish` writes beside those it returns."""


def find_format(kind: FormatKind) -> DemoFormat:
    """Return the writer of a format."""
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
            from kinebench_drake.suites.formats.stills import StillFrames

            return StillFrames()
