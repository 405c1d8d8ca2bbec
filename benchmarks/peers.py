"""Inverse kinematics of other packages, each used as its documentation recommends, on the same problems.

A problem is a smooth track of poses and a posture that reaches the first of them; every solver goes from frame to
frame, starting from its own posture of the previous frame, until the pose is reached to `POSITION_M` and
`ROTATION_RAD`.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeAlias

import numpy as np

from benchmarks.motion import Motion
from kinebench_drake.geometry import Array, invert, pose_difference, rotation_log
from kinebench_drake.kinematics.continuation import continue_path
from kinebench_drake.kinematics.path import search_path
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.track_ik import verify_path
from kinebench_drake.models.robot import N_JOINTS

POSITION_M = 1e-4
ROTATION_RAD = 1e-3
"""Tolerances of a reached pose."""

_STEPS = 50
"""Maximum number of Newton-like steps of a solver for one pose."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IkProblem:
    """A smooth track and the posture to start from."""

    t_s: Array
    """(T,) times [s]."""
    X_BG: Array
    """(T, 4, 4) poses of the TCP in the base [m]."""
    q: Array
    """(T, 7) postures that the track was made from [rad]: solvers start from the first and use no other."""


Solve: TypeAlias = Callable[[Sequence[IkProblem]], list[Array]]
"""Function from problems to their postures, (T, 7) [rad] each; NaN or anything else where there is no solution."""


def problem_of(plant: ArmPlant, motion: Motion, t_s: Array) -> IkProblem:
    """Return the problem of the poses of a motion at times (T,) [s]."""
    q = motion.q(t_s)
    return IkProblem(t_s=t_s - t_s[0], X_BG=plant.forward_path(q), q=q)


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """One way to solve problems."""

    name: str
    how: str
    """How it is used, in a few words."""
    package: str | None
    """Distribution that it needs; None for none but our own."""
    make: Callable[[ArmPlant], Solve]
    """Loads the package, outside of the time that is measured; raises ImportError if it is missing."""

    @property
    def label(self) -> str:
        """Name and version."""
        try:
            name, comma, variant = self.name.partition(",")
            return f"{name} {version(self.package)}{comma}{variant}" if self.package else self.name
        except PackageNotFoundError:
            return self.name


def frame_by_frame(step: Callable[[Array, Array], Array]) -> Solve:
    """Return a solver that solves each pose from the previous posture; `step` takes pose (4, 4) and posture (7,)."""

    def solve(problems: Sequence[IkProblem]) -> list[Array]:
        paths = []
        for problem in problems:
            q = problem.q[0]
            path = []
            for X_BG in problem.X_BG:
                q = step(X_BG, q)
                path.append(q)
            paths.append(np.array(path))
        return paths

    return solve


def _ours(plant: ArmPlant) -> Solve:
    """Return a solver that continues from the start posture, searches the whole path if that fails, and verifies it."""

    def follow(p: IkProblem) -> Array:
        q = continue_path(plant, p.t_s, p.X_BG, p.q[0])
        if np.isnan(q).any():
            q = search_path(plant, p.t_s, p.X_BG, p.q[0])
        return verify_path(plant, p.t_s, p.X_BG, q).q

    return lambda problems: [follow(p) for p in problems]


def _drake(plant: ArmPlant) -> Solve:
    from pydrake.math import RotationMatrix
    from pydrake.multibody.inverse_kinematics import InverseKinematics
    from pydrake.solvers import SnoptSolver, SolverOptions

    rotation: Any = RotationMatrix
    half = np.full(3, 0.5 * POSITION_M / np.sqrt(3.0))  # it stops at the edge of the constraint, or slightly past it
    fingers = plant.drake.GetPositions(plant.context)[N_JOINTS:]
    solver = SnoptSolver()
    options = SolverOptions()
    # The rotation constraint is on the angle's cosine: the default of 1e-6 is coarser than a milliradian.
    options.SetOption(SnoptSolver.id(), "Major feasibility tolerance", 1e-9)

    def step(X_BG: Array, q: Array) -> Array:
        ik: Any = InverseKinematics(plant.drake, plant.context)
        p = X_BG[:3, 3]
        ik.AddPositionConstraint(plant.tcp_frame, np.zeros(3), plant.base_frame, p - half, p + half)
        turn = (plant.base_frame, rotation(X_BG[:3, :3]), plant.tcp_frame, rotation(), 0.5 * ROTATION_RAD)
        ik.AddOrientationConstraint(*turn)
        guess: Any = np.concatenate([q, fingers])
        result: Any = solver.Solve(ik.prog(), guess, options)
        return np.asarray(result.GetSolution(ik.q()), dtype=np.float64)[:N_JOINTS]

    return frame_by_frame(step)


def _newton(plant: ArmPlant) -> Solve:
    def step(X_BG: Array, q: Array) -> Array:
        for _ in range(_STEPS):
            X_now, J = plant.forward_and_jacobian(q)
            turn = rotation_log(X_BG[:3, :3] @ X_now[:3, :3].T)
            move = X_BG[:3, 3] - X_now[:3, 3]
            if np.linalg.norm(move) < POSITION_M and np.linalg.norm(turn) < ROTATION_RAD:
                break
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-12 * np.eye(6), np.concatenate([turn, move]))
        return q

    return frame_by_frame(step)


def _pink(plant: ArmPlant) -> Solve:
    import pink
    import pinocchio

    model = pinocchio.buildModelFromXML(_bare_urdf(plant))
    configuration = pink.Configuration(model, model.createData(), plant.robot.rest_q)
    task = pink.tasks.FrameTask(plant.robot.tcp_link, position_cost=1.0, orientation_cost=1.0)
    return _frame_task(
        configuration,
        task,
        lambda X_BG: pinocchio.SE3(X_BG[:3, :3], X_BG[:3, 3]),
        partial(pink.solve_ik, solver="daqp", damping=1e-12, limits=[]),
    )


def _mink(plant: ArmPlant) -> Solve:
    import mink
    import mujoco

    urdf = ElementTree.fromstring(_bare_urdf(plant))
    extension = ElementTree.SubElement(urdf, "mujoco")
    ElementTree.SubElement(extension, "compiler", fusestatic="false")
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(urdf, encoding="unicode"))
    configuration = mink.Configuration(model)
    task = mink.FrameTask(plant.robot.tcp_link, "body", position_cost=1.0, orientation_cost=1.0)
    solve_ik = partial(mink.solve_ik, solver="daqp", limits=[])
    return _frame_task(configuration, task, mink.SE3.from_matrix, solve_ik)


def _frame_task(configuration: Any, task: Any, target: Callable[[Array], Any], solve_ik: Callable[..., Any]) -> Solve:
    """Return a solver of pink or mink, whose interfaces are alike: steps of 1 s until the task's error is small."""

    def step(X_BG: Array, q: Array) -> Array:
        task.set_target(target(X_BG))
        configuration.update(q)
        for _ in range(_STEPS):
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < POSITION_M and np.linalg.norm(error[3:]) < ROTATION_RAD:
                break
            configuration.integrate_inplace(solve_ik(configuration, [task], 1.0), 1.0)
        return np.array(configuration.q)

    return frame_by_frame(step)


def _pytorch_kinematics(plant: ArmPlant) -> Solve:
    import pytorch_kinematics
    import torch

    chain = pytorch_kinematics.build_serial_chain_from_urdf(_bare_urdf(plant), plant.robot.tcp_link)
    chain = chain.to(dtype=torch.float64)

    def solve(problems: Sequence[IkProblem]) -> list[Array]:
        X = torch.from_numpy(np.concatenate([p.X_BG for p in problems]))
        ik = pytorch_kinematics.PseudoInverseIK(
            chain,
            pos_tolerance=POSITION_M,
            rot_tolerance=ROTATION_RAD,
            retry_configs=torch.from_numpy(
                np.concatenate([np.vstack([p.q[:1], p.q[:-1]]) for p in problems])[:, None]
            ).flatten(1),
            max_iterations=_STEPS,
            lr=1.0,
            early_stopping_any_converged=True,
            early_stopping_no_improvement=None,
        )
        ik.num_retries = 1  # one start for each pose, not all starts for every pose
        q = ik.solve(pytorch_kinematics.Transform3d(matrix=X)).solutions[:, 0].numpy()
        return list(np.split(q, np.cumsum([len(p.t_s) for p in problems])[:-1]))

    return solve


def _frankik(plant: ArmPlant) -> Solve:
    from frankik import FrankaKinematics, RobotType

    solver = FrankaKinematics(RobotType.PANDA)
    X_GF = _flange_in_tool(plant)  # its own constant for the hand is rounded to three digits

    def step(X_BG: Array, q: Array) -> Array:
        solution = solver.inverse(X_BG @ X_GF, q0=q)
        return q if solution is None else np.asarray(solution)

    return frame_by_frame(step)


def _flange_in_tool(plant: ArmPlant) -> Array:
    """Return the pose X_GF (4, 4) [m] of the Panda's flange, the frame of the closed forms, in the TCP frame."""
    q = plant.robot.rest_q
    return np.asarray(invert(plant.forward(q)) @ plant.link_poses(q)["panda_link8"])


def _bare_urdf(plant: ArmPlant) -> str:
    """Return the URDF without shapes and dynamics and with fixed fingers: seven joints and nothing else to compute."""
    root = ElementTree.parse(plant.robot.urdf).getroot()
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for element in link.findall(kind):
                link.remove(element)
    for joint in root.findall("joint"):
        for element in joint.findall("dynamics"):
            joint.remove(element)
        if joint.get("name") in plant.robot.finger_joints:
            joint.set("type", "fixed")
    return ElementTree.tostring(root, encoding="unicode")


OURS = "kinebench-drake"
DRAKE = "Drake InverseKinematics"
NEWTON = "Newton on Drake's Jacobian"

PEERS = (
    Peer(
        name=OURS,
        how="`kinematics.continuation.continue_path`, a track at a time, verified to 1e-6 m and 1e-6 rad",
        package=None,
        make=_ours,
    ),
    Peer(name=DRAKE, how="one program a pose, SNOPT", package="drake", make=_drake),
    Peer(name=NEWTON, how="a plain loop in Python, pseudo-inverse steps", package="drake", make=_newton),
    Peer(name="pin-pink, free", how="FrameTask, daqp, no limits", package="pin-pink", make=_pink),
    Peer(name="mink, free", how="FrameTask, daqp, no limits", package="mink", make=_mink),
    Peer(
        name="pytorch_kinematics, warm start",
        how="PseudoInverseIK, all poses in one batch, each from the true posture of the previous frame",
        package="pytorch-kinematics",
        make=_pytorch_kinematics,
    ),
    Peer(
        name="frankik",
        how="closed form, its sweep of joint 7, the nearest solution",
        package="frankik",
        make=_frankik,
    ),
)
"""Solvers, each in the setting with most smooth tracks (of equal ones the fastest)."""


def reached_share(plant: ArmPlant, problems: Sequence[IkProblem], paths: Sequence[Array]) -> float:
    """Return the share of poses reached, by Drake's forward kinematics, with joints within limits; NaN are not."""
    good = []
    for problem, path in zip(problems, paths, strict=True):
        at = plant.forward_path(np.nan_to_num(path))
        position, rotation = pose_difference(at, problem.X_BG)
        inside = ((path >= plant.lower) & (path <= plant.upper)).all(axis=-1)
        good.append((position <= POSITION_M) & (rotation <= ROTATION_RAD) & inside)
    return float(np.concatenate(good).mean())


def within_speed_share(plant: ArmPlant, problems: Sequence[IkProblem], paths: Sequence[Array]) -> float:
    """Return the share of tracks whose joint path keeps the speed limits, as the paths do that they were made from."""
    good = [
        (np.abs(np.diff(path, axis=0)) <= plant.velocity_limits * np.diff(problem.t_s)[:, None]).all()
        for problem, path in zip(problems, paths, strict=True)
    ]
    return float(np.mean(good))
