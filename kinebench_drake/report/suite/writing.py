"""The two reports: of suite runs, and of a comparison of models."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from kinebench_drake.errors import UsageError
from kinebench_drake.io.atomic import write_atomically
from kinebench_drake.report.suite.comparison import Compared, compare, comparison_table
from kinebench_drake.report.suite.correlation import LEAST_POINTS, study_sparc
from kinebench_drake.report.suite.episode import EpisodeResult, episode_table, scale_costs
from kinebench_drake.report.suite.folders import RunFolder, gather, read_folders
from kinebench_drake.report.suite.kinematic_figures import manipulability_picture, scaling_picture, sparc_picture
from kinebench_drake.report.suite.kinematic_tables import correlation_table, kinematics_table, scaling_table
from kinebench_drake.report.suite.picture import ReportFigure, write_picture
from kinebench_drake.report.suite.scaling import study_scaling, task_difficulties, untagged
from kinebench_drake.report.suite.success_figures import difference_picture, success_pictures, verdict_picture
from kinebench_drake.report.suite.success_tables import suites_table, summary_table, tasks_table
from kinebench_drake.report.suite.suite_page import Drawn, Missing, build_page
from kinebench_drake.report.suite.table import Table, csv_text, latex_text
from kinebench_drake.results.store import REPORT, SAMPLES


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelComparison:
    """Models compared, ready to be told."""

    folders: tuple[RunFolder, ...]
    episodes: tuple[EpisodeResult, ...]
    compared: tuple[Compared, ...]
    table: Table


def write_suite_report(paths: Sequence[Path], out: Path, seed: int = 0) -> Path:
    """Write the report of some suite runs: page, figures and tables. The same folders give the same bytes.

    Args:
        paths: output folders of `suite run`.
        out: folder to write to, made if absent.
        seed: of the intervals' resampling.

    Returns:
        The html page.

    Raises:
        UsageError: the folders cannot be used or put together, or `out` is one of a run.
        SetupError: writing failed.
    """
    _check_out(out)
    folders = read_folders(paths)
    episodes = scale_costs(gather(folders))
    parts: list[Table | ReportFigure] = [suites_table(episodes, seed), summary_table(episodes, seed)]
    missing: list[Missing] = []
    parts += [*success_pictures(episodes), tasks_table(episodes, seed), verdict_picture(episodes)]
    parts.append(kinematics_table(episodes, seed))
    _add_sparc(parts, missing, episodes, seed)
    _add(parts, missing, manipulability_picture(episodes), "Manipulability", "two measured costs span its scale")
    _add_scaling(parts, missing, folders, episodes, seed)
    _write_table(episode_table(episodes), out)
    return _write_page("Suite report", folders, episodes, out, parts, missing)


def read_comparison(paths: Sequence[Path], seed: int = 0) -> ModelComparison:
    """Compare the models of some suite runs on the episodes they share.

    Raises:
        UsageError: the folders cannot be used or put together, or no two models share an episode.
    """
    folders = read_folders(paths)
    episodes = gather(folders)
    compared = compare(episodes, seed)
    return ModelComparison(
        folders=tuple(folders),
        episodes=tuple(episodes),
        compared=tuple(compared),
        table=comparison_table(compared),
    )


def write_comparison(comparison: ModelComparison, out: Path) -> Path:
    """Write a comparison: page, figure and table; returns the page.

    Raises:
        UsageError: `out` is the folder of a run.
        SetupError: writing failed.
    """
    _check_out(out)
    parts: list[Table | ReportFigure] = [comparison.table]
    missing: list[Missing] = []
    if any(c.paired for c in comparison.compared):
        parts.append(difference_picture(comparison.compared))
    else:
        missing.append(Missing(title="Differences of success", needs="episodes that two models both have measured"))
    _write_table(episode_table(comparison.episodes), out)
    return _write_page("ModelComparison of models", comparison.folders, comparison.episodes, out, parts, missing)


def _add_sparc(
    parts: list[Table | ReportFigure], missing: list[Missing], episodes: Sequence[EpisodeResult], seed: int
) -> None:
    study = study_sparc(episodes)
    _add(
        parts, missing, sparc_picture(episodes, study, seed), "SPARC and success", "episodes with SPARC and an outcome"
    )
    table = correlation_table(study, seed)
    if any(study.correlation(p.part).rho is not None for p in study.points) or study.correlation().rho is not None:
        parts.append(table)
    else:
        needs = f"{LEAST_POINTS} models or runs that did the same tasks and differ in SPARC and in success"
        missing.append(Missing(title="Rank correlation of SPARC and success", needs=needs))


def _add_scaling(
    parts: list[Table | ReportFigure],
    missing: list[Missing],
    folders: Sequence[RunFolder],
    episodes: Sequence[EpisodeResult],
    seed: int,
) -> None:
    tagged = "runs on suite 3 with --tag data=N and --tag steps=N, such as data=25 and steps=7500"
    if bare := untagged(folders):
        names = ", ".join(path.resolve().name for path in bare)
        missing.append(Missing(title=f"{names} in the scaling table", needs=f"both tags: {tagged}"))
    if not any(f.part.suite == 3 for f in folders) or len(bare) == sum(f.part.suite == 3 for f in folders):
        missing.append(Missing(title="Scaling", needs=tagged))
        return
    studies = study_scaling(folders, episodes, task_difficulties(), seed)
    parts.append(scaling_table(studies))
    for number, study in enumerate(studies):
        name = "scaling" if len(studies) == 1 else f"scaling_{number + 1}"
        needs = "two trainings that differ in data alone or in steps alone"
        _add(parts, missing, scaling_picture(study, f"{name}_curves"), f"Scaling curves of {study.model}", needs)


def _add(
    parts: list[Table | ReportFigure], missing: list[Missing], picture: ReportFigure | None, title: str, needs: str
) -> None:
    if picture is None:
        missing.append(Missing(title=title, needs=needs))
    else:
        parts.append(picture)


def _write_page(
    title: str,
    folders: Sequence[RunFolder],
    episodes: Sequence[EpisodeResult],
    out: Path,
    parts: Sequence[Table | ReportFigure],
    missing: Sequence[Missing],
) -> Path:
    """Write tables and figures as files, and the page with all of them."""
    ready: list[Table | Drawn] = []
    for part in parts:
        if isinstance(part, Table):
            _write_table(part, out)
            ready.append(part)
        else:
            svg = Markup(write_picture(part, out))
            ready.append(Drawn(name=part.name, title=part.title, caption=part.caption, svg=svg))
    page = out / REPORT
    write_atomically(page, build_page(title, folders, episodes, out, parts=ready, missing=missing).encode())
    return page


def _write_table(table: Table, out: Path) -> None:
    write_atomically(out / f"{table.name}.csv", csv_text(table).encode())
    if table.latex:
        write_atomically(out / f"{table.name}.tex", latex_text(table).encode())


def _check_out(out: Path) -> None:
    if (out / SAMPLES).exists():
        raise UsageError(
            f"--out {out}: is the output folder of a run, whose own report it would overwrite; name another"
        )
