"""Pages about suite runs, with their tables and figures as files: report, comparison, and the paper's."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.number import draw_numbers, tabulate_numbers
from kinebench_drake.report.parts import (
    MissingPart,
    Part,
    Section,
    choose_listed,
    list_links,
    make_missing,
    write_parts,
)
from kinebench_drake.report.run import check_page_folder
from kinebench_drake.report.suite import correlation, kinematics, scaling, success
from kinebench_drake.report.suite.comparison import ModelComparison, draw_differences, tabulate_comparison
from kinebench_drake.report.suite.episode_result import EpisodeResult, has_samples, tabulate_episodes
from kinebench_drake.report.suite.paper import make_sections, read_paper_data
from kinebench_drake.report.suite.pooling import SuiteRun, pool_episodes, read_suite_runs, spec_warnings

PAPER_INDEX, PAPER_MISSING = "index.html", "missing.md"
_PAPER_COMMAND = "kinebench-drake suite report --paper runs/*/ comparison/ robustness.json depth.json --out paper/"


def write_suite_report(
    paths: Sequence[Path], out: Path, seed: int = 0, warn: Callable[[str], None] = lambda message: None
) -> Path:
    """Write the report of some suite runs; the same folders give the same bytes.

    Args:
        paths: output folders of `suite run`.
        out: folder to write to, made if absent.
        seed: seed of the resampling.
        warn: receives warnings, which are on the page as well.

    Returns:
        The html page.

    Raises:
        UsageError: the folders cannot be used or pooled, or `out` is one of a run.
        SetupError: writing failed.
    """
    check_page_folder(out)
    runs = read_suite_runs(paths)
    for message in spec_warnings(runs):
        warn(message)
    episodes = kinematics.scale_costs(pool_episodes(runs))
    following = kinematics.tabulate_following(episodes, seed)
    parts: list[Part] = [
        success.tabulate_suites(episodes, seed),
        success.tabulate_summary(episodes, seed),
        *success.draw_success(episodes),
        success.tabulate_tasks(episodes, seed),
        success.draw_verdicts(episodes),
        kinematics.tabulate_kinematics(episodes, seed),
        *([following] if following else []),
        *_sparc_parts(episodes, seed),
        kinematics.draw_manipulability(episodes) or make_missing("manipulability"),
        *_scaling_parts(runs, episodes, seed),
    ]
    return write_page("Suite report", runs, episodes, out, parts)


def _sparc_parts(episodes: Sequence[EpisodeResult], seed: int) -> list[Part]:
    study = correlation.study_correlation(episodes)
    return [
        correlation.draw_correlation(episodes, study, seed) or make_missing("sparc"),
        correlation.tabulate_correlation(study, seed)
        if study.is_defined
        else make_missing("sparc_correlation", points=correlation.MIN_POINTS),
    ]


def _scaling_parts(runs: Sequence[SuiteRun], episodes: Sequence[EpisodeResult], seed: int) -> list[Part]:
    untagged = scaling.untagged(runs)
    names = ", ".join(run.name for run in untagged)
    parts: list[Part] = [make_missing("scaling_tags", runs=names)] if untagged else []
    if len(untagged) == sum(run.part.suite == scaling.SUITE for run in runs):
        return [*parts, make_missing("scaling")]
    studies = scaling.study_scaling(runs, episodes, scaling.task_difficulties(), seed)
    parts.append(scaling.tabulate_scaling(studies))
    for study, figure in scaling.draw_studies(studies):
        parts.append(figure or make_missing("scaling_curves", model=study.model))
    return parts


def write_comparison(comparison: ModelComparison, out: Path) -> Path:
    """Write a comparison: page, figure and table; returns the page.

    Raises:
        UsageError: `out` is the folder of a run.
        SetupError: writing failed.
    """
    check_page_folder(out)
    parts: list[Part] = [
        tabulate_comparison(comparison.pairs),
        draw_differences(comparison.pairs) or make_missing("differences"),
    ]
    if comparison.numbers:
        parts.append(tabulate_numbers(comparison.numbers))
        parts += [figure] if (figure := draw_numbers(comparison.numbers)) else []
    return write_page("Comparison of models", comparison.runs, comparison.episodes, out, parts, comparison.leads)


def write_page(
    title: str,
    runs: Sequence[SuiteRun],
    episodes: Sequence[EpisodeResult],
    out: Path,
    parts: Sequence[Part],
    leads: Sequence[str] = (),
) -> Path:
    """Write a page about some runs with a list of their episodes, which begins with `leads`; returns the page."""
    listed = choose_listed(episodes, lambda e: (e.part, e.model), lambda e: e.success is True)
    return write_parts(
        "suite_page.html.j2",
        title,
        out,
        parts,
        tabulate_episodes(episodes),
        runs=runs,
        leads=leads,
        warnings=spec_warnings(runs),
        episodes=len(episodes),
        noun="sample" if has_samples(episodes) else "episode",
        lines=[(e, list_links(e.folder, e.row, out)) for e in listed],
    )


def write_paper_report(
    paths: Sequence[Path], out: Path, seed: int = 0, warn: Callable[[str], None] = lambda message: None
) -> Path:
    """Write the paper's tables and figures for which the inputs suffice, and a list of the others with their commands.

    Args and errors are those of `write_suite_report`; `paths` may also name files of studies, see `read_measurements`.
    """
    check_page_folder(out)
    data = read_paper_data(paths, seed)
    for message in data.warnings:
        warn(message)
    sections = make_sections(data)
    write_atomically(out / PAPER_MISSING, missing_text(sections).encode())
    return write_parts(
        "paper_page.html.j2",
        "Tables and figures of the paper",
        out,
        [part for section, own in sections for part in (section, *own)],
        tabulate_episodes(data.episodes),
        PAPER_INDEX,
        sections=[(section, len(own), len(_missing(own))) for section, own in sections],
        runs=data.runs,
        measurements=data.measurements.names,
        warnings=data.warnings,
        episodes=len(data.episodes),
    )


def missing_text(sections: Sequence[tuple[Section, Sequence[Part]]]) -> str:
    """Format all missing parts as Markdown, with the commands that make their data."""
    lines = ["# Missing tables and figures", ""]
    for section, parts in sections:
        lines += [f"## {section.title}", ""] if _missing(parts) else []
        for part in _missing(parts):
            lines += [f"{part.title}: needs {part.needs}.", "", *(f"    {c}" for c in part.commands), ""]
    if len(lines) == 2:
        return "\n".join([*lines, "None.", ""])
    return "\n".join([*lines, "Then, with all runs and files as arguments:", "", f"    {_PAPER_COMMAND}", ""])


def _missing(parts: Sequence[Part]) -> list[MissingPart]:
    return [part for part in parts if isinstance(part, MissingPart)]
