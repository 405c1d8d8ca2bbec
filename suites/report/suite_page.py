"""Pages about suite runs, with their tables and figures as files: report and comparison."""

from collections.abc import Callable, Sequence
from pathlib import Path

from kinebench_drake.report.page_parts import Part, choose_listed, list_links, make_missing, write_parts
from kinebench_drake.report.run import check_page_folder
from kinebench_drake.results.aggregate import group_by
from kinebench_drake.suites.report import correlation, kinematics, scaling, success, transfer
from kinebench_drake.suites.report.episode_result import EpisodeResult, has_samples, tabulate_episodes
from kinebench_drake.suites.report.pooling import (
    SuiteRun,
    differing_settings,
    pool_episodes,
    read_suite_runs,
    spec_warnings,
)


def write_suite_report(
    paths: Sequence[Path],
    out: Path,
    warn: Callable[[str], None] = lambda message: None,
    *,
    paper: bool = False,
) -> Path:
    """Write the report of some suite runs; the same folders give the same bytes.

    Args:
        paths: output folders of `suite run`.
        paper: only what the KineBench paper shows: success and kinematics by suite and model, their correlation, the
            loss from seen to unseen, scaling.

    Returns:
        The html page.
    """
    check_page_folder(out)
    runs = read_suite_runs(paths)
    for message in spec_warnings(runs):
        warn(message)
    episodes = kinematics.scale_costs(pool_episodes(runs))
    following = None if paper else kinematics.tabulate_following(episodes)
    details: list[Part] = []
    if not paper:
        details = [
            success.tabulate_summary(episodes),
            *success.draw_success(episodes),
            success.tabulate_tasks(episodes),
            success.draw_verdicts(episodes),
        ]
    parts: list[Part] = [
        success.tabulate_suites(episodes),
        *details,
        kinematics.tabulate_kinematics(episodes),
        *([following] if following else []),
        *_drop_parts(runs, episodes),
        *_correlation_parts(episodes, correlation.SPARC),
        kinematics.draw_manipulability(episodes) or make_missing("manipulability"),
        *_correlation_parts(episodes, correlation.MANIPULABILITY),
        *_scaling_parts(runs, episodes),
    ]
    return write_page("Suite report", runs, episodes, out, parts)


def _drop_parts(runs: Sequence[SuiteRun], episodes: Sequence[EpisodeResult]) -> list[Part]:
    """Return table and figures of the loss from seen to unseen; none without runs on both splits."""
    from kinebench_drake.suites.catalog import load_suite

    parts: list[Part] = []
    for (model, suite), own in group_by(episodes, lambda e: (e.model, e.part.suite)).items():
        paths = {e.folder for e in own if e.part.split in (transfer.SEEN, transfer.UNSEEN)}
        if names := differing_settings([run for run in runs if run.path in paths]):
            parts.append(make_missing("seen_unseen", model=model, suite=suite, settings=" and ".join(names)))
            episodes = [e for e in episodes if (e.model, e.part.suite) != (model, suite)]
    drops = transfer.study_drops(episodes, load_suite(1).transfers)
    return [transfer.tabulate_drops(drops), *transfer.draw_drops(drops), *parts] if drops else parts


def _correlation_parts(episodes: Sequence[EpisodeResult], predictor: correlation.Predictor) -> list[Part]:
    study = correlation.study_correlation(episodes, predictor)
    points = correlation.MIN_POINTS
    return [
        correlation.draw_correlation(episodes, study) or make_missing("correlation_points", **predictor.captions),
        correlation.tabulate_correlation(study)
        if study.is_defined
        else make_missing("correlation", points=points, **predictor.captions),
    ]


def _scaling_parts(runs: Sequence[SuiteRun], episodes: Sequence[EpisodeResult]) -> list[Part]:
    untagged = scaling.untagged(runs)
    names = ", ".join(run.name for run in untagged)
    parts: list[Part] = [make_missing("scaling_tags", runs=names)] if untagged else []
    if len(untagged) == sum(run.part.suite == scaling.SUITE for run in runs):
        return [*parts, make_missing("scaling")]
    studies = scaling.study_scaling(runs, episodes, scaling.task_difficulties())
    parts.append(scaling.tabulate_scaling(studies))
    for number, study in enumerate(studies, 1):
        name = "scaling_curves" if len(studies) == 1 else f"scaling_{number}_curves"
        parts.append(scaling.draw_scaling(study, name) or make_missing("scaling_curves", model=study.model))
    return parts


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
