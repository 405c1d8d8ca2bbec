"""The paper's tables and figures as a page and files; absent ones with their commands."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.parts import MissingPart, Part, Section, write_parts
from kinebench_drake.report.run import check_page_folder
from kinebench_drake.report.suite.episode import tabulate_episodes
from kinebench_drake.report.suite.folders import pool_episodes, read_folders, setting_warnings, spec_warnings
from kinebench_drake.report.suite.kinematics import scale_costs
from kinebench_drake.report.suite.measurement import is_measurement, read_measurements
from kinebench_drake.report.suite.paper_section import PaperData, make_sections

INDEX, MISSING = "index.html", "missing.md"
_AGAIN = "kinebench-drake suite report --paper runs/*/ comparison/ robustness.json depth.json --out paper/"


def write_paper_report(
    paths: Sequence[Path], out: Path, seed: int = 0, warn: Callable[[str], None] = lambda message: None
) -> Path:
    """Write the paper's tables and figures for which the inputs suffice, and a list of the others with their commands.

    Args:
        paths: output folders of `suite run`; files of `perception` with --json.
        out: folder to write to, made if absent.
        seed: seed of the resampling.
        warn: receives warnings, which are on the page as well.

    Returns:
        The html page.

    Raises:
        UsageError: an input cannot be used, or `out` is the folder of a run.
        SetupError: writing failed.
    """
    check_page_folder(out)
    data = read_paper_data(paths, seed)
    for message in data.warnings:
        warn(message)
    sections = make_sections(data)
    write_atomically(out / MISSING, missing_text(sections).encode())
    return write_parts(
        "paper_page.html.j2",
        "Tables and figures of the paper",
        out,
        [part for section, own in sections for part in (section, *own)],
        tabulate_episodes(data.episodes),
        INDEX,
        contents=[(section, *_count(own)) for section, own in sections],
        folders=data.folders,
        measurements=data.measurements.names,
        warnings=data.warnings,
        episodes=len(data.episodes),
    )


def read_paper_data(paths: Sequence[Path], seed: int = 0) -> PaperData:
    """Read runs and measurements.

    Raises:
        UsageError: there is none, or one cannot be used.
    """
    measured = [path for path in paths if is_measurement(path)]
    runs = [path for path in paths if path not in measured]
    folders = read_folders(runs) if runs or not paths else []
    episodes = pool_episodes(folders)
    return PaperData(
        folders=folders,
        episodes=scale_costs(episodes),
        measurements=read_measurements(measured),
        warnings=[*spec_warnings(folders), *setting_warnings(folders, episodes)],
        seed=seed,
    )


def _count(parts: Sequence[Part]) -> tuple[int, int]:
    """Return the numbers of parts made and missing."""
    missing = sum(isinstance(part, MissingPart) for part in parts)
    return len(parts) - missing, missing


def missing_text(sections: Sequence[tuple[Section, Sequence[Part]]]) -> str:
    """Format all missing parts as Markdown, with the commands that make their data."""
    lines = ["# Missing tables and figures", ""]
    for section, parts in sections:
        missing = [part for part in parts if isinstance(part, MissingPart)]
        lines += [f"## {section.title}", ""] if missing else []
        for part in missing:
            lines += [f"{part.title}: needs {part.needs}.", "", *(f"    {c}" for c in part.commands), ""]
    if len(lines) == 2:
        return "\n".join([*lines, "None.", ""])
    return "\n".join([*lines, "Then, with all runs and files as arguments:", "", f"    {_AGAIN}", ""])
