"""`suite run`: a world model on the episodes of a suite in closed loop.

Of each episode the kinematics of the clips, the gap to the execution and the cause of a failure are stored.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path

from kinebench_drake.camera import BENCHMARK_PX
from kinebench_drake.clip_timing import ClipTiming
from kinebench_drake.environment.precision import network_precision
from kinebench_drake.errors import count_noun
from kinebench_drake.executors.base import ExecutorKind
from kinebench_drake.io.atomic import make_folder, write_atomically
from kinebench_drake.io.container import write_video
from kinebench_drake.io.jsonl import Json, write_json
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.results.inputs import PeriodSource
from kinebench_drake.results.provenance import weights_hash
from kinebench_drake.results.row import SampleRow, Status, sample_suffix
from kinebench_drake.results.store import REQUESTS, artifact_path
from kinebench_drake.results.trackfile import write_track
from kinebench_drake.runs.evaluator import EXECUTABILITY, KINEMATIC_METRICS, Evaluator, fail_row, judge_row
from kinebench_drake.runs.resources import Resources, load_resources
from kinebench_drake.runs.runner import NullRunObserver, RunObserver, RunSummary, run_samples
from kinebench_drake.runs.score import VISUAL_METRICS
from kinebench_drake.suites.catalog import EpisodeSpec
from kinebench_drake.suites.clock import FRAME_PERIOD_S
from kinebench_drake.suites.closed_loop.attribution import find_cause
from kinebench_drake.suites.closed_loop.execution import CommandPlanner
from kinebench_drake.suites.closed_loop.following import (
    ACTION_METRICS,
    ActionSource,
    action_curves,
    measure_following,
    summarize_following,
)
from kinebench_drake.suites.closed_loop.gap import GAP_METRICS, average_gaps, measure_gap
from kinebench_drake.suites.closed_loop.loop import ClosedLoop, EpisodeRun, LoopOptions, PendingRound
from kinebench_drake.suites.composition import Episode
from kinebench_drake.suites.export import FPS, FRAMES, manifest_row
from kinebench_drake.suites.families.registry import OwnTask
from kinebench_drake.suites.rollout import render_video
from kinebench_drake.suites.runs.clips import (
    camera_paths,
    combine,
    domain,
    join_curves,
    join_tracks,
    open_anomalies,
    rejections,
    visual_metrics,
)
from kinebench_drake.suites.runs.pictures import episode_strip, rollout_frames
from kinebench_drake.suites.runs.requests import request_path, write_requests
from kinebench_drake.suites.runs.suite_config import SuiteConfig
from kinebench_drake.suites.simulator import Simulator
from kinebench_drake.suites.simulator_cache import SimulatorCache
from kinebench_drake.suites.start import first_facts
from kinebench_drake.suites.worldmodels.factory import LazyWorldModel
from kinebench_drake.suites.worldmodels.media import png
from kinebench_drake.suites.worldmodels.worldmodel import Condition, OfflineModel, SupportsCheck


def run_suite(config: SuiteConfig, observer: RunObserver | None = None) -> RunSummary:
    """Run every episode of a suite's split with a world model and fill the output folder."""
    observer = observer or NullRunObserver()
    with closing(LazyWorldModel(config.world_model)) as world_model:
        model = world_model.get()
        name = model.name
        offline = isinstance(model, OfflineModel)
        if not offline and (config.jobs > 1 or config.engine is not ExecutorKind.LOCAL):
            world_model.close()  # workers load their own, and may need the memory
        evaluator = EpisodeEvaluator(
            config=replace(config, model_name=name),
            world_model=world_model,
            offline=offline,
        )
        samples = [
            EpisodeSample(spec=spec, index=index, model=config.model or name)
            for spec in config.load_suite().specs(
                config.split, config.episodes, tasks=config.tasks, offset=config.seed, variant=config.variant
            )
            for index in range(config.samples)
        ]
        summary = run_samples(samples, evaluator, observer)
        write_requests(config.out, summary.pending)
        _warn_of_lengths(summary.rows, config.loop, observer)
        return summary


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSample:
    """One episode to run with one world model, once or several times."""

    spec: EpisodeSpec
    index: int = 0
    """Number of the sample among those of the episode."""
    model: str
    """Name of the world model."""

    @property
    def id(self) -> str:
        """Id of the episode, of a further sample followed by its number, such as "StackCube-v1_s0003_k1"."""
        return f"{self.spec.id}{sample_suffix(self.index)}"

    @property
    def video(self) -> str:
        """First clip of the episode, relative to the output folder."""
        return f"videos/{self.id}_r0.mp4"

    @property
    def task(self) -> str:
        """Task id."""
        return self.spec.task


@dataclass(frozen=True, slots=True)
class EpisodeResources:
    """Resources of a process that runs episodes."""

    tools: Resources
    simulators: SimulatorCache[Simulator]
    model: LazyWorldModel
    loop: ClosedLoop
    actions: ActionSource | None = None

    def close(self) -> None:
        """Release simulators and world model."""
        self.simulators.close()
        if self.actions is not None:
            self.actions.close()
        self.model.close()


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeEvaluator(Evaluator[EpisodeSample, EpisodeResources]):
    """Evaluation of the episodes of one run."""

    config: SuiteConfig
    world_model: LazyWorldModel
    offline: bool
    """True if the world model is `OfflineModel`: its files count as input."""

    @property
    def loop(self) -> LoopOptions:
        """Options of the closed loop."""
        return self.config.loop

    def prepare(self, samples: Sequence[EpisodeSample], warn: Callable[[str], None]) -> None:
        """Warn of episodes without a first video in a folder; a server must listen."""
        model = self.world_model.get()
        if isinstance(model, SupportsCheck):
            model.check()
        elif isinstance(model, OfflineModel):
            absent = [s.id for s in samples if not model.files(s.id, s.task, 0)]
            if absent:
                warn(
                    f"{model.name} has no video of {len(absent)} of {count_noun(len(samples), 'episode')}, such as "
                    f"{absent[0]}: they are listed in $out/{REQUESTS}"
                )

    def setup(self) -> EpisodeResources:
        """Load robot, world model and simulator cache."""
        tools = load_resources(self.config.make_resources, self.config.robot_options())
        actions = ActionSource(ArmPlant(), BENCHMARK_PX) if self.loop.condition is Condition.ACTIONS else None
        loop = ClosedLoop(tools.grounder, CommandPlanner(ArmPlant()), self.world_model.get(), self.loop, actions)
        simulators = SimulatorCache(partial(Simulator, control=self.loop.control), BENCHMARK_PX)
        return EpisodeResources(tools, simulators, self.world_model, loop, actions)

    def evaluate(self, sample: EpisodeSample, resources: EpisodeResources, row: SampleRow) -> SampleRow:
        """Run the episode, judge its clips, attribute a failure, write its files."""
        episode = sample.spec.episode()
        simulator = resources.simulators.get(episode.task, episode.variant)
        videos = self.config.out / "videos"
        videos.mkdir(exist_ok=True)
        run = resources.loop.run(simulator, episode, videos / sample.id, sample.index)
        if run.pending is not None:
            return self._ask(sample, episode, run.pending, row)
        executed = [None if r.execution is None else render_video(simulator, r.execution.snapshots) for r in run.rounds]
        tracks = [r.grounding.track for r in run.rounds]
        results = [resources.tools.judge(track) for track in tracks]
        track = join_tracks(tracks)
        kinematics = combine(tracks, results)
        grounded = join_curves([r.grounding.measured.curves for r in run.rounds])
        write_track(
            artifact_path(self.config.out, "tracks", sample.id),
            track,
            kinematics.joints,
            {
                **kinematics.curves,
                **grounded,
                **action_curves(tracks, [r.actions for r in run.rounds]),
            },
        )
        write_atomically(artifact_path(self.config.out, "thumbnails", sample.id), episode_strip(run, executed))
        if self.config.rollouts:
            path = artifact_path(self.config.out, "rollouts", sample.id)
            write_video(path, rollout_frames(run, executed, resources.tools), FPS, crf=20, preset="veryfast")
        cause = find_cause(run, results)
        gap_metrics, gap_reasons = average_gaps(
            [
                measure_gap(done.robot, done.grounding.track.X_BG, video)
                for done, video in zip(run.rounds, executed, strict=True)
                if video is not None
            ]
        )
        clips = [f"videos/{r.video.name}" for r in run.rounds]
        row = replace(row, video=clips[0]).measured(visual_metrics(run, track))
        row = row.measured({**gap_metrics, **self._action_metrics(sample, run)})
        row = row.extended(
            success=run.outcome.success,
            progress=run.outcome.progress,
            domain=domain(run).value,
            anomalies_open=open_anomalies(run),
            rounds=len(run.rounds),
            verdict=None if cause is None else cause.verdict,
            cause=cause,
            missed=[name for name, satisfied in run.outcome.conditions.items() if not satisfied],
            refused=rejections(run),
            prompt=self.loop.prompts.prompt(episode),
            videos=clips,
            clip_timing=run.rounds[0].timing.value,
            clip_frames=[r.generated_frames for r in run.rounds],
            frames=len(track.t_s),
            **camera_paths(run),
        )
        return judge_row(row, kinematics, reasons=gap_reasons, curves=grounded)

    def _action_metrics(self, sample: EpisodeSample, run: EpisodeRun) -> Mapping[str, float | None]:
        """Return how far the clips follow the actions; empty without actions."""
        clips = [
            measure_following(done.grounding.track, done.actions, sample.id, number)
            for number, done in enumerate(run.rounds)
            if done.actions is not None
        ]
        return dict(summarize_following(clips, self.loop.frame_period_s)) if clips else {}

    def _ask(self, sample: EpisodeSample, episode: Episode, pending: PendingRound, row: SampleRow) -> SampleRow:
        """Write the first frame of the next round; return a row with the entry of this round in a manifest."""
        number = pending.request.round
        id = f"{sample.id}_r{number}"
        path = request_path(self.config.out, id)
        make_folder(path.parent)
        state: dict[str, Json] = {
            **{"suite": self.config.suite, "split": self.config.split},
            **first_facts(pending.X_BG, pending.finger_width_m),
            "frame_period_s": self.loop.frame_period_s,
        }
        if (actions := pending.request.actions) is not None:
            write_json(path.with_suffix(".json"), actions.to_json())
            state["actions"] = f"{id}.json"
        write_atomically(path, png(pending.request.first_frame))
        row = row.extended(pending=manifest_row(id, episode, self.loop.prompts, state))
        reason = f"waits for the video of round {number + 1}: generate {id}.mp4 from {REQUESTS}/{id}.png"
        return fail_row(row, Status.UNMEASURABLE, reason)

    def files_of(self, row: SampleRow) -> Sequence[Path]:
        """Return the artifacts of a row, and the first frame that a pending round needs."""
        asked = None if row.pending is None else row.pending["id"]
        requests = [request_path(self.config.out, str(asked))] if asked is not None else []
        return [*Evaluator.files_of(self, row), *requests]

    @property
    def metric_names(self) -> tuple[str, ...]:
        """Visual, gap, action and kinematic metrics."""
        actions = ACTION_METRICS if self.loop.condition is Condition.ACTIONS else ()
        return (*VISUAL_METRICS, *GAP_METRICS, *actions, EXECUTABILITY, *KINEMATIC_METRICS)

    @property
    def artifacts(self) -> tuple[str, ...]:
        """Tracks, thumbnails, and rollouts where they are written."""
        return ("tracks", "thumbnails", *(["rollouts"] if self.config.rollouts else []))

    def cache_key(self, sample: EpisodeSample) -> Mapping[str, Json]:
        """Return weights, world model, loop options and episode."""
        spec = sample.spec
        return {
            "weights": weights_hash(),
            "precision": network_precision().value,
            "world_model": self.world_model.identity,
            "loop": [self.loop.to_json(), FRAMES],
            "episode": [spec.task, spec.seed, spec.pool.value, spec.variant.value],
        }

    def input_files(self, sample: EpisodeSample) -> Sequence[Path]:
        """Return the file of a task of the user's own, the clips of an offline world model up to the first missing."""
        task = sample.spec.task
        own = (task.file,) if isinstance(task, OwnTask) else ()
        model = self.world_model.get() if self.offline else None
        if not isinstance(model, OfflineModel):
            return own
        clips = (model.files(sample.id, sample.task, number) for number in range(self.loop.rounds))
        return [*own, *(file for files in takewhile(bool, clips) for file in files)]

    def labels(self, sample: EpisodeSample) -> Mapping[str, Json]:
        """Return seed, number of the sample, pool, variant, frame period and camera."""
        spec = sample.spec
        period_s = self.loop.frame_period_s
        source = PeriodSource.BENCHMARK if period_s == FRAME_PERIOD_S else PeriodSource.OPTION
        return {
            "seed": spec.seed,
            "sample_index": sample.index,
            "pool": spec.pool.value,
            "variant": spec.variant.value,
            "frame_period_s": period_s,
            "frame_period_source": source.value,
            "camera_source": "benchmark",
            "camera_state": "named",
        }


def _warn_of_lengths(rows: Sequence[SampleRow], loop: LoopOptions, observer: RunObserver) -> None:
    """Warn of clips that do not have the requested number of frames, and say how they were used."""
    period_s = loop.frame_period_s
    expected = FRAMES
    clip_s = period_s * (expected - 1)
    uses = {
        ClipTiming.UNIFORM: f"each was sampled evenly over {clip_s:g} s ($clip_timing native: {period_s:g} s a frame)",
        ClipTiming.NATIVE: f"{period_s:g} s a frame were taken ($clip_timing uniform: {clip_s:g} s a clip)",
    }
    for timing, use in uses.items():
        lengths = [row.clip_frames for row in rows if row.clip_timing == timing.value]
        others = [{*clips} - {expected} for clips in lengths if isinstance(clips, tuple)]
        if frames := sorted({n for clips in others for n in clips}):
            count = sum(bool(clips) for clips in others)
            observer.warn(
                f"{count_noun(count, 'episode')} with clips of {_range(frames)} frames in place of {expected}: {use}"
            )


def _range(numbers: Sequence[int]) -> str:
    """Return the least and the greatest of sorted numbers as text."""
    return f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]} to {numbers[-1]}"
