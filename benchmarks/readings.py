"""Files of trajectories as people have them: which are read rightly, which are named, which are judged wrongly.

One motion is written in many conventions. A file counts as audited if its numbers, with at most a reading file of one
line, are the motion; a mistaken convention counts as named if it has no verdict.
"""

import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
from scipy.spatial.transform import Rotation

from benchmarks.feasible import draw_feasible
from benchmarks.motion import Arm
from benchmarks.moves import Family
from kinebench_drake.errors import KinebenchError
from kinebench_drake.formats.trajectories.reading import TOOLS, Reading, TrajectoryOptions
from kinebench_drake.formats.trajectories.source import find_trajectories, read_trajectory
from kinebench_drake.formats.trajectories.trajectory import Trajectory
from kinebench_drake.geometry import Array, invert, make_pose, pose_difference, to_quaternion
from kinebench_drake.runs.reading_check import assess_readings
from kinebench_drake.runs.resources import Resources, RobotOptions

WORLD_M = np.array([-0.56, 0.0, 0.912])
"""Base of the robot in robosuite's world."""
# of the numbers of a file, which are rounded
_SAME_M = 1e-4
_SAME_RAD = 1e-3
_STEP_S = 0.2
_EE = ("x", "y", "z")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingCase:
    """A file and what it takes to read it."""

    name: str
    path: Path
    keys: Mapping[str, object] = field(default_factory=dict)
    """Reading file of one line; empty if the names suffice."""
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingOutcome:
    """Outcome of one case."""

    name: str
    by_names: str
    """Without the reading file: "right", "no verdict" (with the reading that fits better), "refused" or "WRONG"."""
    by_file: str
    """With it."""


class _Files:
    """Writes one motion in many formats."""

    def __init__(self, folder: Path, q: Array, X_BG: Array) -> None:
        self._folder = folder
        self.q = q
        self.X = X_BG
        self.t_s: Array = _STEP_S * np.arange(len(q), dtype=np.float64)
        self.p = X_BG[:, :3, 3]
        self.rotation = Rotation.from_matrix(X_BG[:, :3, :3])
        self.quaternion = to_quaternion(X_BG[:, :3, :3])
        self.xyzw = self.quaternion[:, [1, 2, 3, 0]]
        self.rpy, self.vector = self.rotation.as_euler("xyz"), self.rotation.as_rotvec()

    def text(self, name: str, header: str, *columns: Array, separator: str = ",", comment: str = "") -> Path:
        path = self._folder / name
        header = header.replace(",", separator)
        np.savetxt(path, np.column_stack(columns), delimiter=separator, header=header, comments=comment)
        return path

    def npz(self, name: str, **arrays: Array) -> Path:
        np.savez(self._folder / f"{name}.npz", **arrays)  # type: ignore[arg-type]
        return self._folder / f"{name}.npz"

    def hdf5(self, name: str, arrays: Mapping[str, Array], env_args: str | None = None) -> Path:
        path = self._folder / f"{name}.hdf5"
        with h5py.File(path, "w") as file:
            for key, values in arrays.items():
                file[key] = values
            if env_args is not None:
                file["data"].attrs["env_args"] = env_args
        return path

    def lerobot(self, name: str, names: list[str] | None, rows: Array, robot: str = "panda") -> Path:
        root = self._folder / name
        feature = {"dtype": "float32", "shape": [rows.shape[1]], "names": names}
        info = {
            **{"codebase_version": "v2.1", "fps": 1.0 / _STEP_S, "robot_type": robot},
            "features": {"observation.state": feature},
        }
        (root / "meta").mkdir(parents=True, exist_ok=True)
        (root / "data" / "chunk-000").mkdir(parents=True, exist_ok=True)
        (root / "meta" / "info.json").write_text(json.dumps(info))
        n = len(rows)
        columns = {
            "observation.state": rows.astype(np.float32).tolist(),
            "frame_index": np.arange(n),
            "episode_index": np.zeros(n, dtype=int),
            "timestamp": self.t_s.astype(np.float32),
        }
        parquet.write_table(pyarrow.table(columns), root / "data" / "chunk-000" / "episode_000000.parquet")
        return root


def plausible_files(folder: Path, q: Array, X_BG: Array) -> Iterator[ReadingCase]:
    """Write files as people have them, of joint angles (T, 7) [rad] and their poses (T, 4, 4) [m]."""
    f = _Files(folder, q, X_BG)
    t = f.t_s
    deg = np.rad2deg(q)
    case = ReadingCase
    numbers = ",".join(f"joint_{k}" for k in range(1, 8))
    yield case(
        name="csv of this program", path=f.text("a.csv", "t_s," + ",".join(f"q{k}_rad" for k in range(1, 8)), t, q)
    )
    yield case(name="csv, joint1..7, time", path=f.text("b.csv", "time," + numbers, t, q))
    yield case(
        name="csv, units in the names",
        path=f.text("c.csv", "time_ms," + ",".join(f"joint{k}_deg" for k in range(1, 8)), 1e3 * t, deg),
    )
    yield case(name="csv, degrees", path=f.text("d.csv", "t," + numbers, t, deg), keys={"angle": "deg"})
    yield case(name="csv, x y z qx qy qz qw", path=f.text("e.csv", "timestamp,x,y,z,qx,qy,qz,qw", t, f.p, f.xyzw))
    yield case(
        name="csv, millimetres and degrees",
        path=f.text("g.csv", "t,x,y,z,roll,pitch,yaw", t, 1e3 * f.p, np.rad2deg(f.rpy)),
        keys={"length": "mm", "angle": "deg"},
    )
    ros = (
        "%time,"
        + ",".join(f"field.position{k}" for k in range(7))
        + ","
        + ",".join(f"field.velocity{k}" for k in range(7))
    )
    yield case(name="rostopic echo -p", path=f.text("h.csv", ros, 1.7e18 + 1e9 * t, q, 0 * q))
    plot = "__time," + ",".join(f"/joint_states/panda_joint{k}/position" for k in range(1, 8))
    yield case(name="PlotJuggler", path=f.text("i.csv", plot, 1.7e9 + t, q))
    yield case(
        name="TUM",
        path=f.text("j.txt", "timestamp,tx,ty,tz,qx,qy,qz,qw", t, f.p, f.xyzw, separator=" ", comment="# "),
    )
    yield case(name="csv, semicolons", path=f.text("k.csv", "t," + numbers, t, q, separator=";"))
    yield case(name="npz of this program", path=f.npz("l", t_s=t, base_from_tcp=X_BG))
    yield case(name="npz, joint_positions, timestamps", path=f.npz("m", timestamps=t, joint_positions=q))
    yield case(
        name="npz, ee_pos, ee_quat (x y z w)",
        path=f.npz("n", time=t, ee_pos=f.p, ee_quat=f.xyzw),
        keys={"layout": "quaternion_xyzw"},
    )
    np.save(folder / "o.npy", q)
    yield case(name="npy (T, 7)", path=folder / "o.npy", rate_hz=1.0 / _STEP_S)
    yield case(name="npz, O_T_EE by columns", path=f.npz("p", t=t, O_T_EE=np.swapaxes(X_BG, 1, 2).reshape(-1, 16)))
    yield case(
        name="ManiSkill h5", path=f.hdf5("q", {"traj_0/obs/agent/qpos": np.hstack([q, 0 * q[:, :2]])}), rate_hz=5.0
    )
    env = json.dumps({"env_kwargs": {"control_freq": 5}})
    obs = {"data/demo_0/obs/robot0_eef_pos": f.p + WORLD_M, "data/demo_0/obs/robot0_eef_quat": f.xyzw}
    yield case(name="robomimic, joints", path=f.hdf5("r", {**obs, "data/demo_0/obs/robot0_joint_pos": q}, env))
    yield case(
        name="robomimic, poses of the world",
        path=f.hdf5("s", obs, env),
        keys={"base_from_world": [0.56, 0.0, -0.912]},
    )
    yield case(name="LIBERO", path=f.hdf5("t", {"data/demo_0/obs/joint_states": q}, env))
    yield case(
        name="ALOHA-like, two arms",
        path=f.hdf5("u", {"observations/qpos": np.hstack([q, q[::-1]])}),
        keys={"columns": "observations/qpos[0:7]", "layout": "joints"},
        rate_hz=1.0 / _STEP_S,
    )
    joints = [f"joint_{k}" for k in range(7)]
    yield case(name="LeRobot, joints", path=f.lerobot("v", [*joints, "gripper"], np.hstack([q, q[:, :1]])))
    names = ["ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz", "ee.gripper_pos"]
    yield case(name="LeRobot, ee.x .. ee.wz", path=f.lerobot("w", names, np.hstack([f.p, f.vector, q[:, :1]])))
    yield case(
        name="LeRobot, rotation vectors called roll pitch yaw",
        path=f.lerobot("x", [*_EE, "roll", "pitch", "yaw"], np.hstack([f.p, f.vector])),
        keys={"layout": "rotation_vector"},
    )
    sides = [f"{side}_{joint}" for side in ("left", "right") for joint in joints]
    yield case(name="LeRobot, two arms", path=f.lerobot("y", sides, np.hstack([q[::-1], q])), keys={"arm": "right"})
    yield case(
        name="LeRobot, state without names",
        path=f.lerobot("z", None, np.hstack([q, q[:, :1]])),
        keys={"columns": "observation.state[0:7]", "layout": "joints"},
    )
    (folder / "aa.json").write_text(json.dumps({"t": t.tolist(), "q": q.tolist()}))
    yield case(name="json", path=folder / "aa.json")


def mistaken_files(folder: Path, q: Array, X_BG: Array) -> Iterator[ReadingCase]:
    """Write files whose names say something else than their numbers are."""
    f = _Files(folder, q, X_BG)
    t = f.t_s
    case = ReadingCase
    pose = "t_s,x,y,z,qw,qx,qy,qz"
    flange = X_BG @ invert(TOOLS["flange"])
    yield case(
        name="quaternions x y z w", path=f.text("A.csv", pose, t, f.p, f.xyzw), keys={"layout": "quaternion_xyzw"}
    )
    yield case(
        name="flange", path=f.text("B.csv", pose, t, flange[:, :3, 3], to_quaternion(flange[:, :3, :3])),
        keys={"tool": "flange"},
    )  # fmt: skip
    yield case(name="millimetres", path=f.text("C.csv", pose, t, 1e3 * f.p, f.quaternion), keys={"length": "mm"})
    yield case(name="milliseconds", path=f.text("D.csv", pose, 1e3 * t, f.p, f.quaternion), keys={"time_unit": "ms"})
    yield case(name="nanoseconds", path=f.text("E.csv", pose, 1e9 * t, f.p, f.quaternion), keys={"time_unit": "ns"})
    world = {"base_from_world": [0.615, 0.0, 0.0]}
    yield case(name="ManiSkill's world", path=f.text("F.csv", pose, t, f.p - [0.615, 0, 0], f.quaternion), keys=world)
    zyx = f.rotation.as_euler("zyx")
    yield case(
        name="Euler angles zyx",
        path=f.text("G.csv", "t_s,x,y,z,roll,pitch,yaw", t, f.p, zyx),
        keys={"layout": "euler_zyx"},
    )
    columns = np.swapaxes(X_BG, 1, 2)
    yield case(
        name="matrices by columns", path=f.npz("H", t_s=t, base_from_tcp=columns), keys={"layout": "matrix_columns"}
    )
    steps = np.diff(f.p, axis=0, append=f.p[-1:])
    turns = np.diff(f.rpy, axis=0, append=f.rpy[-1:])
    yield case(
        name="changes",
        path=f.text("I.csv", "t_s,x,y,z,roll,pitch,yaw", t, steps, (turns + np.pi) % (2 * np.pi) - np.pi),
    )


def check_case(case: ReadingCase, tools: Resources, q: Array, X_BG: Array) -> ReadingOutcome:
    """Read a file by its names and by its reading file, and compare it with the motion."""
    outcomes = []
    for keys in ({}, case.keys):
        choice = TrajectoryOptions(rate_hz=case.rate_hz, reading=Reading.parse(keys) if keys else None)
        try:
            [sample] = find_trajectories(case.path, choice)
            assessment = assess_readings(tools, (sample,), choice)
            trajectory = read_trajectory(sample, choice)
            doubt = assessment.best.name if assessment and assessment.doubt else None
            outcomes.append(f"no verdict: {doubt}" if doubt else "right" if _is_same(trajectory, q, X_BG) else "WRONG")
        except KinebenchError:
            outcomes.append("refused")
    return ReadingOutcome(name=case.name, by_names=outcomes[0], by_file=outcomes[1])


def _is_same(trajectory: Trajectory, q: Array, X_BG: Array) -> bool:
    if trajectory.q is not None:
        same = np.abs(trajectory.q - q).max() < _SAME_RAD
    else:
        X = np.empty((0, 4, 4)) if trajectory.X_BG is None else trajectory.X_BG
        distance, angle = pose_difference(make_pose(X[:, :3, :3], X[:, :3, 3]), X_BG)
        same = distance.max() < _SAME_M and angle.max() < _SAME_RAD
    return bool(same and np.abs(np.diff(trajectory.t_s) - _STEP_S).max() < 1e-3)


def outcome_lines(count: int, seed: int) -> Iterator[str]:
    """Yield a line for each file, with how often each outcome came, over `count` expert-like motions."""
    arm = Arm()
    tools = Resources(RobotOptions())
    by_names = defaultdict[str, Counter[str]](Counter)
    by_file = defaultdict[str, Counter[str]](Counter)
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        trajectory = draw_feasible(rng, arm, family=Family.SHIPPED, proven=False).trajectory(arm)
        q = np.asarray(trajectory.q)
        for make in (plausible_files, mistaken_files):
            with TemporaryDirectory() as folder:
                for case in make(Path(folder), q, arm.plant.forward_path(q)):
                    outcome = check_case(case, tools, q, arm.plant.forward_path(q))
                    by_names[outcome.name][outcome.by_names] += 1
                    by_file[outcome.name][outcome.by_file] += 1
    for name in by_names:
        outcomes = (", ".join(f"{n} {text}" for text, n in own[name].most_common()) for own in (by_names, by_file))
        yield f"{name}: {next(outcomes)}; with its reading file: {next(outcomes)}"
