"""Tables of kinematics and of what it has to do with success, and of scaling."""

from collections.abc import Sequence

from kinebench_drake.report.suite.correlation import Correlation, SparcStudy
from kinebench_drake.report.suite.episode import EpisodeResult, group
from kinebench_drake.report.suite.scaling import Scaling
from kinebench_drake.report.suite.table import Column, Table, Value
from kinebench_drake.report.suite.tally import mean
from kinebench_drake.results.aggregate import Estimate

_METRICS = (
    ("sparc", "SPARC", "{:.2f}", "nearer 0 is smoother"),
    ("sparc_rotation", "SPARC, rotation", "{:.2f}", "nearer 0 is smoother"),
    ("ldlj", "Log dimensionless jerk", "{:.2f}", "nearer 0 is smoother"),
    ("manipulability_mean", "Manipulability", "{:.4f}", "volume of the 6x7 Jacobian; 0 is singular"),
    ("ik_success_rate", "IK success", "{:.1%}", "share of frames reached within joint limits"),
    ("slowdown_min", "Slow-down needed", "{:.2f}", "1 or less can be played at its own speed"),
    ("tracked_fraction", "Frames tracked", "{:.1%}", "share of frames whose pose can be relied upon"),
    ("gap_gripper_m", "Imagined to executed [m]", "{:.4f}", "distance between the two grippers"),
    ("gap_robot_iou", "Robot overlap", "{:.2f}", "intersection over union of the imagined and the executed robot"),
)


def kinematics_table(episodes: Sequence[EpisodeResult], seed: int = 0) -> Table:
    """Task-balanced kinematic metrics of every model on every part."""
    groups = sorted(group(episodes, lambda e: (e.part, e.model)).items(), key=lambda item: item[0][0])
    metrics = [m for m in _METRICS if any(e.metric(m[0]) is not None for e in episodes)]
    return Table(
        name="kinematics",
        title="Motion of the imagined gripper",
        note="Means over tasks of the episodes that have the metric, with 95 % bootstrap intervals over episodes "
        "within tasks; successes and failures alike.",
        columns=(
            Column(key="part", label="Suite"),
            Column(key="model", label="Model"),
            Column(
                key="manipulability_cost_scaled", label="Manipulability cost, scaled", pattern="{:.2f}", estimated=True,
                meaning="0 at the 10th percentile of all episodes here, 1 at the 90th; lower is better",
            ),
            *(Column(key=k, label=label, pattern=p, meaning=m, estimated=True) for k, label, p, m in metrics),
        ),
        rows=tuple(
            (
                part.title,
                model,
                mean(own, lambda e: e.cost_scaled, seed),
                *(mean(own, lambda e, key=key: e.metric(key), seed) for key, *_ in metrics),  # type: ignore[misc]
            )
            for (part, model), own in groups
        ),
    )  # fmt: skip


def correlation_table(study: SparcStudy, seed: int = 0) -> Table:
    """Spearman's rho between SPARC and success, of each part and of all."""
    parts = sorted({p.part for p in study.points})
    rows: list[tuple[Value, ...]] = [(p.title, *_correlated(study.correlation(p, seed))) for p in parts]
    if len(parts) > 1:
        rows.append(("All", *_correlated(study.correlation(None, seed))))
    return Table(
        name="sparc_correlation",
        title="SPARC and success",
        note="Spearman's rank correlation between a model's task-balanced mean SPARC and its success standardised "
        "within tasks; 95 % bootstrap intervals over tasks. Three models at least.",
        columns=(
            Column(key="part", label="Suite"),
            Column(
                key="rho", label="Spearman's rho", pattern="{:.2f}", estimated=True, meaning="1: smoother is better"
            ),
            Column(key="points", label="Models"),
            Column(key="tasks", label="Tasks"),
        ),
        rows=tuple(rows),
    )


def scaling_table(studies: Sequence[Scaling]) -> Table:
    """Success of each training by difficulty of the tasks."""
    levels = list(dict.fromkeys(level for s in studies for level in s.levels[:-1]))
    levels += [s.levels[-1] for s in studies[:1]]
    return Table(
        name="scaling",
        title="Success by demonstrations, steps and difficulty of the tasks",
        note="Suite 3: means over the tasks of a difficulty, with 95 % bootstrap intervals over episodes within tasks.",
        columns=(
            Column(key="model", label="Model"),
            Column(key="data", label="Demonstrations a task"),
            Column(key="steps", label="Steps"),
            *(Column(key=f"success_{v}", label=v.capitalize(), pattern="{:.1%}", estimated=True) for v in levels),
        ),
        rows=tuple(
            (s.model, training.data, training.steps, *(s.success.get((training, level)) for level in levels))
            for s in studies
            for training in s.trainings
        ),
    )


def _correlated(found: Correlation) -> tuple[Value, ...]:
    rho = Estimate(mean=found.rho, low=found.low, high=found.high, n=found.points, total=found.points)
    return rho, found.points, found.tasks
