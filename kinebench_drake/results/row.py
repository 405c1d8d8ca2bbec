"""One line of `samples.jsonl`: the result of one sample, a typed record whose fields are the keys of the line.

In memory a stored row keeps its numbers and labels; what takes most bytes is read from the file on demand. The table of
keys in docs/formats.md and the JSON schema are written from this module (`python -m benchmarks schema`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from kinebench_drake.anomaly import Anomaly
from kinebench_drake.errors import InputError
from kinebench_drake.io.jsonl import Json, dump, intern_text
from kinebench_drake.results.direction import BOUND
from kinebench_drake.results.lines import RowLine, StoredObject
from kinebench_drake.results.record import convert, field_converters, read_record, to_json
from kinebench_drake.violation import Violation

VERDICT_SHARES = ("executable", "feasible")
"""Verdicts, whose shares stand beside the metrics."""
FOLLOWING = (
    *("follows", "follow_share", "lag_frames", "gain", "deviation_m", "deviation_rad", "deviation_finger_m"),
    *("deviation_px", "deviation_hands", "drift_from_frame", "drift_m"),
)
"""Measures of a clip against its actions or its real clip."""
OUTCOMES = ("success", "progress", "rounds", *FOLLOWING)
"""Numbers of closed-loop episodes and of following, which stand beside the metrics."""
MetricValue = float | tuple[Anomaly, ...] | None
ANOMALIES = "anomalies"
"""Name of the only metric that is no number."""


class Metrics(Mapping[str, MetricValue]):
    """Metrics by name in few bytes, with those as attributes that the program reads; None if not measurable."""

    __slots__ = ("_places", "_values")

    def __init__(self, values: Mapping[str, MetricValue] | None = None) -> None:
        values = values or {}
        self._places = _places(tuple(values))
        self._values = tuple(values.values())

    @classmethod
    def from_json(cls, data: object) -> "Metrics":
        """Convert the object of a row.

        Raises:
            InputError: a value is no metric.
        """
        if not isinstance(data, Mapping):
            raise InputError("metrics are no object")
        values = dict(data)
        listed = values.get(ANOMALIES)
        if isinstance(listed, list | tuple):
            values[ANOMALIES] = tuple(read_record(Anomaly, anomaly) for anomaly in listed)
        for name, value in values.items():
            if not isinstance(value, float | int | None) and not (name == ANOMALIES and listed is not None):
                raise InputError(f"the metric {name} is {value!r:.60}")
        return cls(values)

    def __getitem__(self, name: str) -> MetricValue:
        return self._values[self._places[name]]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        return Metrics, (dict(self),)

    @property
    def numbers(self) -> dict[str, float | None]:
        """Numbers and truth values by name."""
        return {name: cast(float | None, value) for name, value in self.items() if name != ANOMALIES}

    def number(self, name: str) -> float | None:
        """Return a number or a truth value; None if it is not measurable, or not among the metrics."""
        value = self.get(name)
        return None if isinstance(value, tuple) else value

    @property
    def anomalies(self) -> tuple[Anomaly, ...] | None:
        """Anomalies of a video; None if none were looked for."""
        return cast(tuple[Anomaly, ...] | None, self.get(ANOMALIES))

    @property
    def tracked_fraction(self) -> float | None:
        """Share of the frames with a pose."""
        return self.number("tracked_fraction")

    @property
    def confidence_mean(self) -> float | None:
        """Mean confidence of the frames with a pose."""
        return self.number("confidence_mean")

    @property
    def motionless(self) -> bool:
        """True if the gripper neither moves nor turns."""
        return self.get("motionless") is True

    @property
    def feasible_from_period_s(self) -> float | None:
        """Shortest frame period at which the motion is feasible [s]."""
        return self.number("feasible_from_period_s")

    @property
    def slowdown_min(self) -> float | None:
        """Least k for which the track played k times slower keeps every limit."""
        return self.number("slowdown_min")

    @property
    def time_scale(self) -> float | None:
        """Fastest feasible duration of the path over its own."""
        return self.number("time_scale")

    @property
    def trajopt_feasible(self) -> bool | None:
        """Whether a trajectory within all limits exists near the track."""
        return cast(bool | None, self.get("trajopt_feasible"))

    @property
    def trajopt_position_tube_m(self) -> float | None:
        """Radius of the tube about the track that holds that trajectory [m]."""
        return self.number("trajopt_position_tube_m")


@lru_cache(maxsize=4096)
def _places(names: tuple[str, ...]) -> dict[str, int]:
    return {intern_text(name): k for k, name in enumerate(names)}


@lru_cache(maxsize=4096)
def _shared_keys(keys: tuple[str, ...]) -> tuple[str, ...]:
    return keys


class Status(Enum):
    """Outcome of a sample."""

    OK = "ok"
    UNMEASURABLE = "unmeasurable"
    ERROR = "error"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrustEntry:
    """Whether the numbers of a video can be used unseen (`metrics.trust`)."""

    level: str
    reason: str
    line: str
    """Level, reason and what the numbers rest on, in one line."""
    unknown: Mapping[str, object] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseEntry:
    """Cause of a failed episode (`suites.closed_loop.attribution`)."""

    verdict: str
    round: int | None
    """Clip with the evidence; null for the episode as a whole."""
    frame_start: int | None
    """First frame of the evidence in this clip (0-based)."""
    frame_end: int | None
    """Last one, inclusive."""
    value: float | None
    """Measured value, in the unit of `text`."""
    limit: float | None
    text: str
    unknown: Mapping[str, object] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionLag:
    """Frames by which the states of a recording follow its actions (`metrics.recording_faults`)."""

    frames: int
    tolerance: int
    correlation: float
    unknown: Mapping[str, object] = field(default_factory=dict, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class SampleRow:
    """The result of one sample. The keys up to `details` are in every row; of the others those that it has."""

    id: str
    """Name of the sample, safe as a file name."""
    video: str
    """Video or trajectory as named by the input, relative to it; a part of a file after a `#`: `demo.h5#traj_3`."""
    task: str | None
    """Name of the task."""
    model: str | None
    """Name of the model that made the sample."""
    status: Status
    """Outcome: `ok`, `unmeasurable` or `error`."""
    reason: str | None
    """Reason for a status other than `ok`, one line."""
    content_hash: str
    """SHA-256 of all inputs of the result: a row with the same hash need not be computed again."""
    feasible: bool | None = None
    """Whether the arm can do the motion that was seen; null: undecided."""
    executable: bool | None = None
    """Whether a robot can execute the sample as it is seen; null: undecided."""
    executable_reasons: tuple[str, ...] = ()
    """What speaks against executing the sample, and what could not be measured."""
    violations: tuple[Violation, ...] = ()
    """Limits that the motion breaks, by cause, within a kind by frame."""
    metrics: Metrics = field(default_factory=Metrics)
    """Metrics by name: numbers, truth values, anomalies; null if unmeasurable. Where frames are lost or out of reach,
    `NAME_bound` is the worst that NAME can be."""
    null_reasons: Mapping[str, str] = field(default_factory=dict)
    """Reason for each null metric, by name; for a sample that is not ok see `reason`."""
    details: Mapping[str, Json] = field(default_factory=dict)
    """Data behind the verdict: limits, noise, checks joint by joint, timing, trajectory optimisation."""

    seed: int | None = None
    """Seed of the sample's scene."""
    prompt: str | None = None
    """Text that the model was given."""
    success: bool | None = None
    """Whether the task was done: of episodes as measured, of others as labelled by the input."""
    format: str | None = None
    """Format of a trajectory."""
    input_sha256: str | None = None
    """SHA-256 of the input file, of several that of the output of `sha256sum FILES`."""
    warnings: tuple[str, ...] | None = None
    """What a user should know of how a trajectory was read."""
    trust: TrustEntry | None = None
    """What the numbers of a video rest on, in one line, and whether they can be used unseen."""

    frames: int | None = None
    """Number of frames that are used."""
    frame_period_s: float | None = None
    """Task time between two frames [s]."""
    frame_period_source: str | None = None
    """Source of the frame period."""
    duration_s: float | None = None
    """Duration of a trajectory [s]."""
    clip_timing: str | None = None
    """How the frames of a video lie in task time: `native` or `uniform`."""
    clip_frames: int | tuple[int, ...] | None = None
    """Number of frames of the video; of episodes of each clip."""
    surplus_frames: int | None = None
    """Frames beyond the table of a dataset, which are not used."""

    width: int | None = None
    """Width of the video, or of the panel that was read [px]."""
    height: int | None = None
    """Height of the video, or of the panel that was read [px]."""
    view: str | None = None
    """Panel of tiled frames that was read: its place or number."""
    panels: tuple[Mapping[str, Json], ...] | None = None
    """Panels of tiled frames: number, place, kind, rectangle [px]."""
    fps: float | None = None
    """Frames per second by the file [1/s]."""
    framing: Mapping[str, Json] | None = None
    """How the camera's image lies in the video."""
    mirrored: bool | None = None
    """True if the frames were turned left-right."""
    replaced: Mapping[str, Json] | None = None
    """Stages of the grounding supplied from outside, with the source of each."""
    first_frame: str | None = None
    """Use of the initial state: `unknown`, `used` or `contradicted`."""
    domain: str | None = None
    """Look of the video to the networks: `familiar`, `unfamiliar` or `arm_alone`."""
    gripper: str | None = None
    """Gripper other than Franka's hand that was looked for."""
    hand_size_error: float | None = None
    """Relative error of the hand's size by the arm behind it."""
    hand_size_sigma: float | None = None
    """Standard error of it."""
    anomaly_scores: Mapping[str, Json] | None = None
    """Greatest score of each kind of anomaly, 1 at its bound."""
    anomalies_open: tuple[str, ...] | None = None
    """Kinds of anomaly of which it is open whether they occur."""
    lost_frames: tuple[Mapping[str, Json], ...] | None = None
    """Frames of a video without a pose, `frame_start` to `frame_end`, with the `reason`."""
    anomalies_not_looked_for: tuple[str, ...] | None = None
    """Kinds of anomaly that the look of the video excludes."""

    camera_key: str | None = None
    """Name of the camera in its dataset."""
    camera_source: str | None = None
    """Source of the camera."""
    camera_state: str | None = None
    """How the camera is known: `named`, `confirmed`, `estimated` or `none`."""
    camera_name: str | None = None
    """Name of a camera that was recognized."""
    camera_shown: str | None = None
    """How the pictures of a recognized camera are turned."""
    camera_agreement: float | None = None
    """Share of the arm's contours on image edges."""
    camera_estimate: Mapping[str, Json] | None = None
    """Estimate of the camera, with its errors."""
    camera_contradiction: Mapping[str, Json] | None = None
    """Camera that explains the arm better than the named one."""
    camera_reading: Mapping[str, Json] | None = None
    """Reading of picture or matrix that explains the arm better."""
    camera_path: Mapping[str, Json] | None = None
    """How the view of the video changes."""
    camera_paths: tuple[Mapping[str, Json] | None, ...] | None = None
    """The same of each clip of an episode."""
    base_frame_reason: str | None = None
    """Why there is no base frame, and the sample is undecided."""
    possible_cameras: int | None = None
    """Number of cameras that may be right, under all of which the verdict holds."""
    table_height_m: float | None = None
    """Height of the table top in the robot base frame that is stated with the camera [m]."""

    judged: str | None = None
    """Columns of a trajectory that are judged: `joints` or `poses`."""
    followed: str | None = None
    """Part of the poses that an arm of five joints is checked to follow."""
    arms: tuple[str, ...] | None = None
    """Arms of a trajectory of two, `left` and `right`; `details` has metrics and checks of each."""
    columns: str | None = None
    """Arrays or columns of a trajectory that were read."""
    frames_tracked: int | None = None
    """Frames of a trajectory with a pose or joint angles."""
    dropped_samples: tuple[int, ...] | None = None
    """Frames before which a recording lacks samples."""
    idle_ends: tuple[int, ...] | None = None
    """Frames in which the robot rests at the start, and at the end."""
    fingerprint: str | None = None
    """Hash of the motion, equal in copies."""
    action_lag: ActionLag | None = None
    """Frames by which the states of a recording follow its actions."""

    follows: bool | None = None
    """Whether the clip follows its actions, or without any its real clip; null: undecided (docs/following.md)."""
    follow_reason: str | None = None
    """What this rests on, or why it is undecided."""
    follow_share: float | None = None
    """Share of the frames inside the tube about the actions; lost frames count as outside."""
    lag_frames: float | None = None
    """Delay of the motion behind the actions [frames]; null where no delay is clear."""
    gain: float | None = None
    """Motion made over motion commanded; null where nearly none is commanded."""
    deviation_m: float | None = None
    """Distance of the TCP from the commanded one at that delay: median, a lost frame worse than any; null where half of
    the frames are lost, and without a base frame [m]."""
    deviation_rad: float | None = None
    """The same of the rotation between them [rad]."""
    deviation_finger_m: float | None = None
    """The same of the gap between the finger pads [m]."""
    deviation_px: float | None = None
    """The same of the TCP in the image [px of the video]."""
    deviation_hands: float | None = None
    """The same over the length of the hand in the image, 0.1034 m from its flange to the TCP; without a base frame."""
    drift_from_frame: int | None = None
    """Frame from which on the clip stays beyond 1 cm or 5 degrees of the actions; null if it does not."""
    drift_m: float | None = None
    """Median distance from there on [m]; without a base frame null."""
    controls: Mapping[str, Json] | None = None
    """Share of the frames inside the tube about the actions of each control: `shuffled`, `reversed`, `still`."""
    link_agreement: Mapping[str, Json] | None = None
    """Share of the contours of the links on image edges in the commanded postures, `own`, and in those of each control;
    where the gripper decides nothing."""
    reference_error_m: float | None = None
    """Error of the track of the real clip, which is taken out: no less than that from a second coding of it [m]."""
    reference_error_px: float | None = None
    """The same in the image [px of the video]."""
    reference: Mapping[str, Json] | None = None
    """The same keys for a clip with actions against its real clip; `real_follows`: verdict on that one's own motion."""

    sample_index: int = 0
    """Number of the sample among those of its episode, from 0."""
    pool: str | None = None
    """Pool of the episode's objects."""
    variant: str | None = None
    """Variant of the episode's scene."""
    progress: float | None = None
    """Share of the task's steps completed."""
    rounds: int | None = None
    """Clips requested from the model."""
    verdict: str | None = None
    """Cause of a failed episode in a word; null for a success."""
    cause: CauseEntry | None = None
    """Cause of a failed episode, with its evidence."""
    missed: tuple[str, ...] | None = None
    """Conditions of the goal that do not hold."""
    refused: tuple[Mapping[str, Json], ...] | None = None
    """What was not commanded as generated."""
    videos: tuple[str, ...] | None = None
    """Clips of the episode, relative to the output folder."""
    pending: Mapping[str, Json] | None = None
    """Entry in a manifest of the video that the episode waits for."""

    unknown: Mapping[str, Json] = field(default_factory=dict)
    """Keys that this version does not have."""
    keys: tuple[str, ...] = ()
    """Keys in the order of the line, as far as it is defined; one whose value is None is null in the line."""
    line: RowLine | None = field(default=None, compare=False, repr=False)
    """Place in the file of a stored row."""

    @property
    def episode(self) -> str:
        """Id of the episode, which is that of its first sample."""
        return self.id.removesuffix(sample_suffix(self.sample_index))

    @property
    def anomalies(self) -> tuple[Anomaly, ...]:
        """Anomalies of the video; none if none were looked for."""
        return self.metrics.anomalies or ()

    def has(self, key: str) -> bool:
        """Return whether the line has a further key, be it null."""
        return key in self.keys or getattr(self, key) != _FURTHER[key]

    def value(self, name: str) -> float | None:
        """Return a verdict, an outcome of an episode or a metric by its name; None if it is not measured."""
        if name in VERDICT_SHARES or name in OUTCOMES:
            return cast(float | None, getattr(self, name))
        return self.metrics.number(name)

    def number(self, name: str) -> float | None:
        """Return a value as a number, truth values as 0 or 1; None if it, or the sample, is not measured."""
        value = self.value(name)
        return float(value) if self.status is Status.OK and value is not None else None

    def bound(self, name: str) -> float | None:
        """Return the worst that a value can be, by which samples are compared: itself unless frames are lost."""
        return self.metrics.number(name + BOUND) if name + BOUND in self.metrics else self.value(name)

    def extended(self, **values: Any) -> "SampleRow":
        """Return the row with further keys, appended in this order.

        Raises:
            InputError: a value is not of the type of its key.
        """
        converters = field_converters(SampleRow)
        typed = {key: convert(converters, key, value) for key, value in values.items()}
        return replace(self, **typed, keys=_shared_keys((*self.keys, *typed)))

    def measured(self, metrics: Mapping[str, MetricValue]) -> "SampleRow":
        """Return the row with further metrics; those that it has keep their place."""
        return replace(self, metrics=Metrics({**self.metrics, **metrics}))

    def to_json(self) -> dict[str, Json]:
        """Return the JSON object, without NaN, infinity or invalid text."""
        further = filter(self.has, _FURTHER)
        keys = dict.fromkeys((*KEYS, *self.keys, *further, *self.unknown))
        values = {key: self.unknown[key] if key in self.unknown else getattr(self, key) for key in keys}
        return cast(dict[str, Json], intern_text(to_json(values)))

    def is_same(self, other: "SampleRow") -> bool:
        """Return whether both rows have the same JSON."""
        if self.line is not None and other.line is not None and self.line.read() == other.line.read():
            return True
        return dump(self.to_json()) == dump(other.to_json())

    @classmethod
    def from_json(cls, data: object, line: RowLine | None = None) -> "SampleRow":
        """Convert a parsed line.

        Args:
            line: its place in a file, from which the row reads on demand what takes most memory; None: it keeps all.

        Raises:
            InputError: the object is not a row.
        """
        if not isinstance(data, dict):
            raise InputError(f"expected an object, found {type(data).__name__}")
        converters = field_converters(cls)
        values: dict[str, Any] = {}
        unknown: dict[str, Json] = {}
        try:
            for key, value in cast(dict[str, Any], data).items():
                if line is not None and key in _ON_DEMAND and isinstance(value, dict) and value:
                    values[key] = StoredObject(line, key)
                elif key in KEYS or key in _FURTHER:
                    values[key] = convert(converters, key, value)
                else:
                    unknown[key] = intern_text(value)
            keys = _shared_keys(tuple(key for key in data if key not in KEYS))
            row = cls(**values, unknown=unknown, keys=keys, line=line)
        except (InputError, TypeError) as error:
            raise InputError(f"not a row of samples.jsonl ({error})") from None
        # The id names the sample's files.
        if not row.id or row.id != Path(row.id).name or row.id.startswith(".") or "\0" in row.id:
            raise InputError(f"not a row of samples.jsonl (its id {row.id!r:.60} is no file name)")
        return row


def sample_suffix(index: int) -> str:
    """Return what follows the id of an episode in that of one of its samples; the first sample has the same id."""
    return f"_k{index}" if index else ""


_ALL = {f.name: f.default for f in fields(SampleRow) if f.name not in ("unknown", "keys", "line")}
KEYS = tuple(_ALL)[: tuple(_ALL).index("details") + 1]
"""Keys of every row, in their order."""
_FURTHER = {name: default for name, default in _ALL.items() if name not in KEYS}
"""Other keys, with the value of rows that do not have them."""
_ON_DEMAND = ("null_reasons", "details")
"""Keys that are read from the file on demand."""
