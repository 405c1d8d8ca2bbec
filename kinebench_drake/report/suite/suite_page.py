"""Reports of suite runs and of comparisons: the html page with its tables and figures, and these as files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinebench_drake.errors import UsageError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.figures import ReportFigure, write_figure
from kinebench_drake.report.page import template_environment
from kinebench_drake.report.sample import explain, relative_link
from kinebench_drake.report.suite import correlation, kinematics, scaling, success
from kinebench_drake.report.suite.comparison import ModelComparison, draw_differences, tabulate_comparison
from kinebench_drake.report.suite.episode import EpisodeResult, group_by, tabulate_episodes
from kinebench_drake.report.suite.folders import RunFolder, pool_episodes, read_folders
from kinebench_drake.report.table import Table, sort_key, table_csv, table_latex
from kinebench_drake.results.store import REPORT, SAMPLES, artifact_path

LISTED = 2000
"""Episodes on the page: more would make it slow to open."""
_SHOWN = 200
"""Episodes in its list until all are requested."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingPart:
    """A table or figure that cannot be made."""

    title: str
    needs: str
    """Data that would be needed."""


Part = Table | ReportFigure | MissingPart


def write_suite_report(paths: Sequence[Path], out: Path, seed: int = 0) -> Path:
    """Write the report of some suite runs: page, figures and tables. The same folders give the same bytes.

    Args:
        paths: output folders of `suite run`.
        out: folder to write to, made if absent.
        seed: seed of the resampling.

    Returns:
        The html page.

    Raises:
        UsageError: the folders cannot be used or pooled, or `out` is one of a run.
        SetupError: writing failed.
    """
    _check_out(out)
    folders = read_folders(paths)
    episodes = kinematics.scale_costs(pool_episodes(folders))
    parts: list[Part] = [
        success.tabulate_suites(episodes, seed),
        success.tabulate_summary(episodes, seed),
        *success.draw_success(episodes),
        success.tabulate_tasks(episodes, seed),
        success.draw_verdicts(episodes),
        kinematics.tabulate_kinematics(episodes, seed),
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
    _check_out(out)
    figure = draw_differences(comparison.pairs) or MissingPart(
        title="Differences of success", needs="episodes measured for two models"
    )
    table = tabulate_comparison(comparison.pairs)
    return write_page("Comparison of models", comparison.folders, comparison.episodes, out, [table, figure])


def _sparc_parts(episodes: Sequence[EpisodeResult], seed: int) -> list[Part]:
    study = correlation.study_sparc(episodes)
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


def _check_out(out: Path) -> None:
    if (out / SAMPLES).exists():
        raise UsageError(
            f"--out {out}: is the output folder of a run, whose own report it would overwrite; name another"
        )


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
    for table in (tabulate_episodes(episodes), *(part for part in parts if isinstance(part, Table))):
        write_atomically(out / f"{table.name}.csv", table_csv(table).encode())
        if table.latex:
            write_atomically(out / f"{table.name}.tex", table_latex(table).encode())
    templates = template_environment()
    templates.filters |= {"key": sort_key, "explanation": explain}
    page = templates.get_template("suite_page.html.j2").render(
        title=title,
        folders=folders,
        episodes=len(episodes),
        parts=[
            (part, write_figure(part, out) if isinstance(part, ReportFigure) else None)
            for part in parts
            if not isinstance(part, MissingPart)
        ],
        missing=[part for part in parts if isinstance(part, MissingPart)],
        lines=[(e, _links(e, out)) for e in _choose_listed(episodes)],
        left_out=max(len(episodes) - LISTED, 0),
        first=_SHOWN,
    )
    write_atomically(out / REPORT, page.encode())
    return out / REPORT


def _links(episode: EpisodeResult, out: Path) -> list[tuple[str, str]]:
    """List labels and addresses of an episode's files: rollout, first imagined clip, entry in the run's own report.

    Only for runs in the parent folder of `out` or below it: other links would reveal paths of this machine and break
    when the report is moved.
    """
    if episode.folder is None:
        return []
    base, home = episode.folder.resolve(), out.resolve()
    if not base.is_relative_to(home.parent):
        return []
    files = (
        ("rollout", artifact_path(base, "rollouts", episode.row.id), ""),
        ("video", base / episode.row.video, ""),
        ("report", base / REPORT, episode.row.id),
    )
    return [
        (label, relative_link(file, home, anchor))
        for label, file, anchor in files
        if file.is_file() and file.resolve().is_relative_to(home.parent)
    ]


def _choose_listed(episodes: Sequence[EpisodeResult]) -> list[EpisodeResult]:
    """Choose LISTED episodes, those without success first, evenly over models and parts."""
    turns = {
        id(e): (e.success is True, turn)
        for own in group_by(episodes, lambda e: (e.part, e.model, e.success is True)).values()
        for turn, e in enumerate(own)
    }
    chosen = {id(e) for e in sorted(episodes, key=lambda e: turns[id(e)])[:LISTED]}
    return sorted((e for e in episodes if id(e) in chosen), key=lambda e: e.success is True)
