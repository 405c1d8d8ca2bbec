"""Reports of suite runs and of comparisons: the html page with its tables and figures, and these as files."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinebench_drake.report.number import draw_numbers, tabulate_numbers
from kinebench_drake.report.parts import MissingPart, Part, choose_listed, list_links, write_parts
from kinebench_drake.report.run import check_page_folder
from kinebench_drake.report.suite import correlation, kinematics, scaling, success
from kinebench_drake.report.suite.comparison import ModelComparison, draw_differences, tabulate_comparison
from kinebench_drake.report.suite.episode import EpisodeResult, has_samples, tabulate_episodes
from kinebench_drake.report.suite.folders import RunFolder, pool_episodes, read_folders, spec_warnings


def write_suite_report(
    paths: Sequence[Path], out: Path, seed: int = 0, warn: Callable[[str], None] = lambda message: None
) -> Path:
    """Write the report of some suite runs: page, figures and tables. The same folders give the same bytes.

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
    folders = read_folders(paths)
    for message in spec_warnings(folders):
        warn(message)
    episodes = kinematics.scale_costs(pool_episodes(folders))
    parts: list[Part] = [
        success.tabulate_suites(episodes, seed),
        success.tabulate_summary(episodes, seed),
        *success.draw_success(episodes),
        success.tabulate_tasks(episodes, seed),
        success.draw_verdicts(episodes),
        kinematics.tabulate_kinematics(episodes, seed),
        *([following] if (following := kinematics.tabulate_following(episodes, seed)) else []),
        *_sparc_parts(episodes, seed),
        kinematics.draw_manipulability(episodes)
        or MissingPart(title="Manipulability", needs="two episodes with a measured cost"),
        *_scaling_parts(folders, episodes, seed),
    ]
    return write_page("Suite report", folders, episodes, out, parts)


def write_comparison(comparison: ModelComparison, out: Path) -> Path:
    """Write a comparison: page, figure and table; returns the page.

    Raises:
        UsageError: `out` is the folder of a run.
        SetupError: writing failed.
    """
    check_page_folder(out)
    parts: list[Part] = [
        tabulate_comparison(comparison.pairs),
        draw_differences(comparison.pairs)
        or MissingPart(title="Differences of success", needs="episodes measured for two models"),
    ]
    if comparison.numbers:
        parts.append(tabulate_numbers(comparison.numbers))
        parts += [figure] if (figure := draw_numbers(comparison.numbers)) else []
    return write_page("Comparison of models", comparison.folders, comparison.episodes, out, parts)


def _sparc_parts(episodes: Sequence[EpisodeResult], seed: int) -> list[Part]:
    study = correlation.study_correlation(episodes)
    figure = correlation.draw_correlation(episodes, study, seed) or MissingPart(
        title="SPARC and success", needs="episodes with SPARC and an outcome"
    )
    if any(study.correlate(part)[0].mean is not None for part in (None, *(p.part for p in study.points))):
        return [figure, correlation.tabulate_correlation(study, seed)]
    needs = f"{correlation.MIN_POINTS} models or runs that did the same tasks and differ in SPARC and in success"
    return [figure, MissingPart(title="Rank correlation of SPARC and success", needs=needs)]


def _scaling_parts(folders: Sequence[RunFolder], episodes: Sequence[EpisodeResult], seed: int) -> list[Part]:
    tagged = "runs on suite 3 with --tag data=N and --tag steps=N, such as data=25 and steps=7500"
    parts: list[Part] = []
    bare = scaling.untagged(folders)
    if bare:
        names = ", ".join(path.resolve().name for path in bare)
        parts.append(MissingPart(title=f"{names} in the scaling table", needs=f"both tags: {tagged}"))
    if len(bare) == sum(f.part.suite == scaling.SUITE for f in folders):
        return [*parts, MissingPart(title="Scaling", needs=tagged)]
    studies = scaling.study_scaling(folders, episodes, scaling.task_difficulties(), seed)
    parts.append(scaling.tabulate_scaling(studies))
    for number, study in enumerate(studies, 1):
        name = "scaling_curves" if len(studies) == 1 else f"scaling_{number}_curves"
        needs = "two trainings that differ in data alone or in steps alone"
        missing = MissingPart(title=f"Scaling curves of {study.model}", needs=needs)
        parts.append(scaling.draw_scaling(study, name) or missing)
    return parts


def write_page(
    title: str, folders: Sequence[RunFolder], episodes: Sequence[EpisodeResult], out: Path, parts: Sequence[Part]
) -> Path:
    """Write a page, and its tables and figures as files; the same input gives the same bytes.

    Args:
        title: heading.
        folders: the runs it is about.
        episodes: the episodes to list.
        out: folder of the page and of the files.
        parts: tables and figures in their order.
    """
    listed = choose_listed(episodes, lambda e: (e.part, e.model), lambda e: e.success is True)
    return write_parts(
        "suite_page.html.j2",
        title,
        out,
        parts,
        tabulate_episodes(episodes),
        folders=folders,
        warnings=spec_warnings(folders),
        episodes=len(episodes),
        noun="sample" if has_samples(episodes) else "episode",
        lines=[(e, list_links(e.folder, e.row, out)) for e in listed],
    )
