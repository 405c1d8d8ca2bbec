"""Laws of geometry and of file formats, for randomly drawn values."""

import json
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinebench_drake import geometry as g
from kinebench_drake.camera import Camera
from kinebench_drake.errors import InputError, KinebenchError, UsageError
from kinebench_drake.formats.camerafile import load_camera, save_camera
from kinebench_drake.formats.manifest import read_manifest
from kinebench_drake.formats.samples import safe, unique_ids
from kinebench_drake.formats.trajectories.check import check
from kinebench_drake.formats.trajectories.trajectory import RawTrajectory
from kinebench_drake.io.jsonl import dump, parse_json
from kinebench_drake.results.metadata import RunMetadata
from kinebench_drake.results.record import to_json
from kinebench_drake.results.row import SampleRow, Status
from kinebench_drake.results.store import SAMPLES, read_rows
from kinebench_drake.results.trackfile import read_track, write_track
from kinebench_drake.track import GripperTrack, IkStatus, JointTrack
from kinebench_drake.violation import ViolationKind
from tests.rows import make_row, make_violation

usual = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])

numbers = st.floats(-2.0, 2.0, allow_subnormal=False)
vectors = st.tuples(numbers, numbers, numbers).map(np.array)
rotations = vectors.map(g.rotation_exp)
poses = st.builds(g.make_pose, rotations, vectors)
texts = st.text(max_size=30)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=12,
)
strict = json_values.map(to_json)


def plain(error: KinebenchError) -> None:
    """A refusal is one line that a terminal can be shown."""
    assert str(error).isprintable()


# Geometry


@usual
@given(poses, poses)
def test_inverse_of_a_product_is_the_product_of_inverses_in_reverse_order(X, Y):
    np.testing.assert_allclose(g.invert(X) @ X, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(g.invert(X @ Y), g.invert(Y) @ g.invert(X), atol=1e-12)
    np.testing.assert_allclose(g.checked_pose(X), X, atol=1e-12)


@usual
@given(poses, st.lists(vectors, min_size=1, max_size=5).map(np.array))
def test_transforming_points_by_a_pose_and_its_inverse_is_the_identity(X, points):
    np.testing.assert_allclose(g.transform_points(g.invert(X), g.transform_points(X, points)), points, atol=1e-11)


@usual
@given(rotations, vectors)
def test_quaternions_of_either_sign_round_trip(R, p):
    quaternion = g.to_quaternion(R)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(g.from_quaternion(quaternion, p), g.make_pose(R, p), atol=1e-12)
    np.testing.assert_allclose(g.from_quaternion(-quaternion, p), g.make_pose(R, p), atol=1e-12)


@usual
@given(vectors)
def test_rotation_vectors_below_pi_round_trip(w):
    angle = np.linalg.norm(w)
    w = w if angle < 3.0 else w * (3.0 / angle)
    np.testing.assert_allclose(g.rotation_log(g.rotation_exp(w)), w, atol=1e-9)


@usual
@given(poses, poses, st.floats(0.0, 1.0))
def test_interpolation_divides_distance_and_angle_in_proportion(X, Y, s):
    Z = g.interpolate_pose(X, Y, s)
    whole = g.pose_difference(X, Y)
    part = g.pose_difference(X, Z)
    assert part[0] == pytest.approx(s * whole[0], abs=1e-9)
    if whole[1] < 3.1:  # beyond it the shorter way round is a matter of rounding
        assert part[1] == pytest.approx(s * whole[1], abs=1e-6)


cameras = st.builds(
    Camera,
    width=st.integers(1, 4000),
    height=st.integers(1, 4000),
    fx=st.floats(10.0, 5000.0),
    fy=st.floats(10.0, 5000.0),
    cx=st.floats(-100.0, 4000.0),
    cy=st.floats(-100.0, 4000.0),
    X_BC=poses,
)


@usual
@given(cameras, st.floats(0.1, 5.0), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_projected_points_are_recovered_from_their_depth(camera, depth, x, y):
    u, v = camera.project([x * depth, y * depth, depth])
    back = np.linalg.inv(camera.K) @ [u, v, 1.0] * depth
    np.testing.assert_allclose(back, [x * depth, y * depth, depth], atol=1e-8)


@usual
@given(cameras, st.integers(1, 4))
def test_a_resized_camera_scales_pixel_coordinates(camera, factor):
    larger = camera.resized(factor * camera.width, factor * camera.height)
    np.testing.assert_allclose(larger.project([0.1, 0.2, 0.7]), factor * camera.project([0.1, 0.2, 0.7]), rtol=1e-9)


# Formats: what is written is what is read


@usual
@given(cameras)
def test_cameras_round_trip_through_their_file(tmp_path, camera):
    save_camera(camera, tmp_path / "camera.json")
    read = load_camera(tmp_path / "camera.json").camera
    np.testing.assert_allclose(read.X_BC, camera.X_BC, atol=1e-12)
    assert {k: v for k, v in asdict(read).items() if k != "X_BC"} == {
        k: v for k, v in asdict(camera).items() if k != "X_BC"
    }


@usual
@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_tracks_round_trip_through_their_file(tmp_path, n, seed):
    rng = np.random.default_rng(seed)
    X = g.make_pose(g.rotation_exp(rng.normal(size=(n, 3))), rng.normal(size=(n, 3)))
    tracked = rng.random(n) < 0.7
    X[~tracked] = np.nan
    track = GripperTrack(
        t_s=np.cumsum(rng.random(n)),
        X_CH=X,
        X_BG=X[::-1],
        tracked=tracked,
        confidence=rng.random(n),
        finger_width_m=np.where(tracked, 0.08 * rng.random(n), np.nan),
    )
    status = tuple(IkStatus(str(s)) for s in rng.choice([s.value for s in IkStatus], n))
    joints = JointTrack(
        t_s=track.t_s,
        q=rng.normal(size=(n, 7)),
        status=status,
        position_error_m=rng.random(n),
        rotation_error_rad=rng.random(n),
    )
    path = tmp_path / "a.npz"
    write_track(path, track, joints, {"torque": rng.normal(size=(n, 7))})
    read = read_track(path)
    for name in ("t_s", "X_CH", "X_BG", "tracked", "confidence", "finger_width_m"):
        np.testing.assert_array_equal(getattr(read.track, name), getattr(track, name))
    np.testing.assert_array_equal(read.q, joints.q)
    assert read.status == status
    first = path.read_bytes()
    write_track(path, track, joints, {"torque": read.curves["torque"]})
    assert path.read_bytes() == first


words = st.text(min_size=1, max_size=20)
violations = st.builds(
    make_violation,
    kind=st.sampled_from([kind.value for kind in ViolationKind]),
    frame_start=st.integers(0, 99),
    joint=st.none() | texts,
    value=st.floats(),
    novel=strict,
)
names = words.filter(lambda name: name != "anomalies")
further = {"seed": st.none() | st.integers(0, 9), "fps": st.floats(), "videos": st.lists(texts)}
rows = st.builds(
    make_row,
    id=words.map(safe),
    video=texts,
    task=st.none() | texts,
    model=st.none() | texts,
    status=st.sampled_from(Status),
    reason=st.none() | texts,
    content_hash=texts,
    feasible=st.none() | st.booleans(),
    violations=st.lists(violations, max_size=3),
    metrics=st.dictionaries(
        words.filter(lambda name: name != "anomalies"), st.none() | st.booleans() | st.floats(), max_size=4
    ),
    null_reasons=st.dictionaries(texts, texts, max_size=3),
    details=st.dictionaries(texts, strict, max_size=3),
    unknown=st.dictionaries(words.map("x_{}".format), strict, max_size=3),
    extra=st.fixed_dictionaries(
        {}, optional={"seed": st.none() | st.integers(0, 9), "fps": st.floats(), "videos": st.lists(texts)}
    ),
)


@usual
@given(st.lists(rows, max_size=4))
def test_rows_round_trip_through_samples_jsonl(tmp_path, given_rows):
    (tmp_path / SAMPLES).write_text("".join(dump(row.to_json()) for row in given_rows))
    kept = read_rows(tmp_path)
    for id, row in {row.id: row for row in given_rows}.items():
        assert dump(kept[id].to_json()) == dump(SampleRow.from_json(parse_json(dump(row.to_json()))).to_json())
        assert list(kept[id].metrics) == list(row.metrics)


entries = st.fixed_dictionaries(
    {"video": words},
    optional={
        "id": words,
        "task": texts,
        "seed": st.integers(-(10**17), 10**17),
        "model": texts,
        "prompt": texts,
        "fps": st.floats(0.01, 1000.0),
        "frame_period_s": st.floats(0.001, 100.0),
        "first_finger_width_m": st.floats(0.0, 0.08),
        "first_base_from_tcp": poses.map(np.ndarray.tolist),
        "camera": cameras.map(Camera.to_json),
    },
)


@usual
@given(st.lists(entries, min_size=1, max_size=4))
def test_manifests_round_trip_through_their_file(tmp_path, lines):
    path = tmp_path / "manifest.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    read = read_manifest(path)
    assert [line.problem for line in read] == [None] * len(lines)
    for line, told in zip(read, lines, strict=True):
        assert line.entry is not None
        assert line.entry.model_dump(exclude_unset=True) == told


# Formats: any JSON at all is read, or refused on purpose


@usual
@given(json_values)
def test_any_json_is_read_as_a_camera_or_refused(value):
    try:
        Camera.from_json(value, "camera.json")
    except UsageError as error:
        plain(error)


@usual
@given(json_values, st.sampled_from(["width", "fx", "cy", "base_from_camera"]), cameras)
def test_a_camera_with_any_value_of_a_key_is_read_or_refused(value, key, camera):
    try:
        found = Camera.from_json({**camera.to_json(), key: value}, "camera.json")
    except UsageError as error:
        plain(error)
    else:
        assert np.isfinite(found.K).all()


@usual
@given(json_values, st.sampled_from([*SampleRow.__dataclass_fields__]))
def test_any_json_is_read_as_a_row_or_refused(value, key):
    sound = SampleRow(id="a", video="a", task=None, model=None, status=Status.OK, reason=None, content_hash="0")
    for data in (value, {**sound.to_json(), key: value}):
        try:
            dump(SampleRow.from_json(data).to_json())
        except InputError as error:
            plain(error)


@usual
@given(json_values)
def test_arbitrary_json_is_refused_as_run_metadata(value):
    with pytest.raises(InputError):
        RunMetadata.from_json(value)


@usual
@given(json_values, st.sampled_from(["video", "id", "seed", "fps", "camera", "first_base_from_tcp", "first_frame"]))
def test_a_manifest_line_with_any_value_is_an_entry_or_a_problem(tmp_path, value, key):
    path = tmp_path / "manifest.jsonl"
    path.write_text(json.dumps({"video": "a.mp4", key: value}) + "\n" + json.dumps(value) + "\n")
    for line in read_manifest(path):
        assert (line.entry is None) is (line.problem is not None)


arrays = st.builds(
    lambda shape, kind, seed: (100 * np.random.default_rng(seed).normal(size=shape)).astype(kind),
    st.lists(st.integers(0, 5), max_size=3),
    st.sampled_from(["f4", "f8", "i4", "u1", "?", "c16", "U3", "M8[s]"]),
    st.integers(0, 99),
)


@usual
@given(arrays | st.none(), arrays, st.booleans(), arrays | st.none(), arrays | st.none())
def test_any_arrays_are_accepted_as_a_trajectory_or_refused(t_s, values, joints, tracked, width):
    recording = RawTrajectory(
        t_s=t_s,
        q=values if joints else None,
        X_BG=None if joints else values,
        tracked=tracked,
        finger_width_m=width,
        columns="x",
    )
    with np.errstate(all="ignore"):
        try:
            found = check(recording)
        except KinebenchError as error:
            plain(error)
        else:
            assert (np.diff(found.t_s) > 0).all()


# Names


@usual
@given(st.lists(st.tuples(st.text(max_size=200), st.lists(texts, max_size=2).map(tuple)), max_size=8))
def test_ids_are_unique_file_names(wanted):
    ids = unique_ids(wanted)
    assert len({id.casefold() for id in ids}) == len(wanted)
    for id in ids:
        assert id == safe(id) or len(id.encode()) > 100
        assert "/" not in id
        assert id not in ("", ".", "..")
