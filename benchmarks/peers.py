"""Inverse kinematics of other packages, each used as its documentation recommends, on one and the same problem.

A problem is a smooth track of poses and a posture that reaches the first of them; every solver goes from frame to
frame, starting from its own posture of the frame before, until the pose is reached to `POSITION_M` and `ROTATION_RAD`.
"""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeAlias

import numpy as np

from kinebench_drake.geometry import Array, invert, pose_difference, rotation_log
from kinebench_drake.kinematics.analytic import analytic_ik
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.kinematics.track import follow_poses
from kinebench_drake.models.robot import N_JOINTS

POSITION_M, ROTATION_RAD = 1e-4, 1e-3
"""How near a pose must be reached."""

_STEPS = 50  # the most Newton-like steps a solver may take for one pose


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """A smooth track, and where to start."""

    t_s: Array
    """(T,) times [s]."""
    X_BG: Array
    """(T, 4, 4) poses of the TCP in the base [m]."""
    q: Array
    """(T, 7) postures that the track was made from [rad]: the first is the start. Solvers see no other."""


Solve: TypeAlias = Callable[[Sequence[Problem]], list[Array]]
"""From problems to their postures, (T, 7) [rad] each; NaN or anything else where a solver finds none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """One way to solve a problem."""

    name: str
    how: str
    """How it is used, in a few words."""
    package: str | None
    """The package it comes from beyond those that are always there; None for none."""
    make: Callable[[ArmPlant], Solve]
    """Load what it needs, outside of the time that is measured; raises ImportError where the package is missing."""

    @property
    def label(self) -> str:
        """Its name with the version."""
        try:
            name, comma, variant = self.name.partition(",")
            return f"{name} {version(self.package)}{comma}{variant}" if self.package else self.name
        except PackageNotFoundError:
            return self.name


def frame_by_frame(step: Callable[[Array, Array], Array]) -> Solve:
    """Solve each pose from the posture of the one before; `step` takes a pose (4, 4) and a posture (7,)."""

    def solve(problems: Sequence[Problem]) -> list[Array]:
        paths = []
        for problem in problems:
            q, path = problem.q[0], []
            for X_BG in problem.X_BG:
                q = step(X_BG, q)
                path.append(q)
            paths.append(np.array(path))
        return paths

    return solve


def _ours(plant: ArmPlant) -> Solve:
    return lambda problems: [follow_poses(plant, p.t_s, p.X_BG, p.q[0]).q for p in problems]


def _ours_held(plant: ArmPlant) -> Solve:
    """The closed form and no more: joint 7 keeps its angle, the branch is the one the start lies on."""
    X_GF = _flange_in_tool(plant)

    def path(problem: Problem) -> Array:
        start = problem.q[0]
        branches = analytic_ik(problem.X_BG @ X_GF, start[-1])
        return branches[:, np.nanargmin(np.abs(branches[0] - start).max(axis=-1))]

    return lambda problems: [path(p) for p in problems]


def _drake(plant: ArmPlant, *, near: bool) -> Solve:
    """`near`: with the cost of leaving the posture before, as in Drake's own course."""
    from pydrake.math import RotationMatrix
    from pydrake.multibody.inverse_kinematics import InverseKinematics
    from pydrake.solvers import SnoptSolver, SolverOptions

    rotation: Any = RotationMatrix
    half = np.full(3, 0.5 * POSITION_M / np.sqrt(3.0))  # it stops at the edge of what it may, and a little past it
    fingers = plant.drake.GetPositions(plant.context)[N_JOINTS:]
    solver, options = SnoptSolver(), SolverOptions()
    # The constraint on rotation is in the angle's cosine: with the default of 1e-6 a milliradian drowns.
    options.SetOption(SnoptSolver.id(), "Major feasibility tolerance", 1e-9)

    def step(X_BG: Array, q: Array) -> Array:
        ik: Any = InverseKinematics(plant.drake, plant.context)
        p = X_BG[:3, 3]
        ik.AddPositionConstraint(plant.tcp_frame, np.zeros(3), plant.base_frame, p - half, p + half)
        turn = (plant.base_frame, rotation(X_BG[:3, :3]), plant.tcp_frame, rotation(), 0.5 * ROTATION_RAD)
        ik.AddOrientationConstraint(*turn)
        guess: Any = np.concatenate([q, fingers])
        if near:
            ik.prog().AddQuadraticErrorCost(np.eye(len(guess)), guess, ik.q())
        found: Any = solver.Solve(ik.prog(), guess, options)
        return np.asarray(found.GetSolution(ik.q()), dtype=np.float64)[:N_JOINTS]

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


def _pink(plant: ArmPlant, *, limited: bool) -> Solve:
    import pink
    import pinocchio

    model = pinocchio.buildModelFromXML(_bare_urdf(plant))
    configuration = pink.Configuration(model, model.createData(), plant.robot.rest_q)
    task = pink.tasks.FrameTask(plant.robot.tcp_link, position_cost=1.0, orientation_cost=1.0)
    limits: list[Any] | None = None if limited else []

    def step(X_BG: Array, q: Array) -> Array:
        task.set_target(pinocchio.SE3(X_BG[:3, :3], X_BG[:3, 3]))
        configuration.update(q)
        for _ in range(_STEPS):
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < POSITION_M and np.linalg.norm(error[3:]) < ROTATION_RAD:
                break
            rate = pink.solve_ik(configuration, [task], 1.0, solver="daqp", damping=1e-12, limits=limits)
            configuration.integrate_inplace(rate, 1.0)
        return np.array(configuration.q)

    return frame_by_frame(step)


def _mink(plant: ArmPlant, *, limited: bool) -> Solve:
    import mink
    import mujoco

    urdf = ElementTree.fromstring(_bare_urdf(plant))
    extension = ElementTree.SubElement(urdf, "mujoco")
    ElementTree.SubElement(extension, "compiler", fusestatic="false")
    model = mujoco.MjModel.from_xml_string(ElementTree.tostring(urdf, encoding="unicode"))
    configuration = mink.Configuration(model)
    task = mink.FrameTask(plant.robot.tcp_link, "body", position_cost=1.0, orientation_cost=1.0)
    limits: list[Any] | None = None if limited else []

    def step(X_BG: Array, q: Array) -> Array:
        task.set_target(mink.SE3.from_matrix(X_BG))
        configuration.update(q)
        for _ in range(_STEPS):
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < POSITION_M and np.linalg.norm(error[3:]) < ROTATION_RAD:
                break
            rate = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(rate, 1.0)
        return np.array(configuration.q)

    return frame_by_frame(step)


def _pytorch_kinematics(plant: ArmPlant) -> Solve:
    """All poses in one batch, each from the posture at the start of its track: a batch knows no frame before."""
    return _batched(plant, lambda p: np.repeat(p.q[:1], len(p.q), axis=0))


def _pytorch_kinematics_told(plant: ArmPlant) -> Solve:
    """The same, each pose told the posture of the frame before that its track was made from."""
    return _batched(plant, lambda p: np.vstack([p.q[:1], p.q[:-1]]))


def _batched(plant: ArmPlant, start: Callable[[Problem], Array]) -> Solve:
    import pytorch_kinematics
    import torch

    chain = pytorch_kinematics.build_serial_chain_from_urdf(_bare_urdf(plant), plant.robot.tcp_link)
    chain = chain.to(dtype=torch.float64)

    def solve(problems: Sequence[Problem]) -> list[Array]:
        X = torch.from_numpy(np.concatenate([p.X_BG for p in problems]))
        ik = pytorch_kinematics.PseudoInverseIK(
            chain,
            pos_tolerance=POSITION_M,
            rot_tolerance=ROTATION_RAD,
            retry_configs=torch.from_numpy(np.concatenate([start(p) for p in problems])[:, None]).flatten(1),
            max_iterations=_STEPS,
            lr=1.0,
            early_stopping_any_converged=True,
            early_stopping_no_improvement=None,
        )
        ik.num_retries = 1  # one start for each pose, not all starts for every pose
        q = ik.solve(pytorch_kinematics.Transform3d(matrix=X)).solutions[:, 0].numpy()
        return list(np.split(q, np.cumsum([len(p.t_s) for p in problems])[:-1]))

    return solve


def _frankik(plant: ArmPlant, *, held: bool, sweep: bool) -> Solve:
    """`held`: joint 7 as in the frame before; `sweep`: 60 angles of it, if held only where that finds nothing."""
    from frankik import FrankaKinematics, RobotType

    solver = FrankaKinematics(RobotType.PANDA)
    X_GF = _flange_in_tool(plant)  # its own constant for the hand is rounded to three digits

    def step(X_BG: Array, q: Array) -> Array:
        found = solver.inverse(X_BG @ X_GF, q0=q, q7=q[6]) if held else None
        found = solver.inverse(X_BG @ X_GF, q0=q) if found is None and sweep else found
        return q if found is None else np.asarray(found)

    return frame_by_frame(step)


def _flange_in_tool(plant: ArmPlant) -> Array:
    """Pose X_GF (4, 4) [m] of the Panda's flange, of which the closed forms know, in the TCP."""
    q = plant.robot.rest_q
    return np.asarray(invert(plant.forward(q)) @ plant.link_poses(q)["panda_link8"])


def _bare_urdf(plant: ArmPlant) -> str:
    """The robot without shapes and dynamics, its fingers fixed: seven joints and nothing else to compute."""
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
OURS_HELD = "kinebench-drake, held"
PLAIN_DRAKE = "Drake InverseKinematics"
OWN_PARTS = "Newton on Drake's Jacobian"
TOLD = "pytorch_kinematics, told"
"""Not in the running: it starts from postures that nobody has who only has the poses."""
FRANKIK_HELD = "frankik, held, no sweep"
"""Not in the running either, as it finds nothing where joint 7 should move: to be compared with ours held likewise."""

PEERS = (
    Peer(name=OURS, how="`kinematics.ik.follow`, a track at a time, to 1e-6 m and 1e-6 rad", package=None, make=_ours),
    Peer(
        name=OURS_HELD,
        how="closed form, `kinematics.analytic.analytic_ik`, a track at a time, joint 7 as at the start, no sweep",
        package=None,
        make=_ours_held,
    ),
    Peer(name=PLAIN_DRAKE, how="one program a pose, SNOPT", package="drake", make=partial(_drake, near=False)),
    Peer(
        name=f"{PLAIN_DRAKE}, near",
        how="the same with the quadratic cost of leaving the posture before",
        package="drake",
        make=partial(_drake, near=True),
    ),
    Peer(name=OWN_PARTS, how="a plain loop in Python, pseudo-inverse steps", package="drake", make=_newton),
    Peer(name="pin-pink", how="FrameTask, daqp, its own limits", package="pin-pink", make=partial(_pink, limited=True)),
    Peer(name="pin-pink, free", how="the same without limits", package="pin-pink", make=partial(_pink, limited=False)),
    Peer(name="mink", how="FrameTask, daqp, its own limits", package="mink", make=partial(_mink, limited=True)),
    Peer(name="mink, free", how="the same without limits", package="mink", make=partial(_mink, limited=False)),
    Peer(
        name="pytorch_kinematics",
        how="PseudoInverseIK, all poses in one batch, each from the start of its track",
        package="pytorch-kinematics",
        make=_pytorch_kinematics,
    ),
    Peer(
        name=TOLD,
        how="the same, each pose told the true posture of the frame before",
        package="pytorch-kinematics",
        make=_pytorch_kinematics_told,
    ),
    Peer(
        name="frankik",
        how="closed form, its sweep of joint 7, the solution nearest",
        package="frankik",
        make=partial(_frankik, held=False, sweep=True),
    ),
    Peer(
        name="frankik, held",
        how="closed form, joint 7 as in the frame before, the sweep where that finds nothing",
        package="frankik",
        make=partial(_frankik, held=True, sweep=True),
    ),
    Peer(
        name=FRANKIK_HELD,
        how="closed form, joint 7 as at the start, no sweep",
        package="frankik",
        make=partial(_frankik, held=True, sweep=False),
    ),
)


def reached(plant: ArmPlant, problems: Sequence[Problem], paths: Sequence[Array]) -> float:
    """Share of poses that Drake's forward kinematics finds reached, joints within their limits; NaN are none."""
    good = []
    for problem, path in zip(problems, paths, strict=True):
        at = np.array([plant.forward(q) for q in np.nan_to_num(path)])
        position, rotation = pose_difference(at, problem.X_BG)
        inside = ((path >= plant.lower) & (path <= plant.upper)).all(axis=-1)
        good.append((position <= POSITION_M) & (rotation <= ROTATION_RAD) & inside)
    return float(np.concatenate(good).mean())


def kept_up(plant: ArmPlant, problems: Sequence[Problem], paths: Sequence[Array]) -> float:
    """Share of tracks whose postures follow each other within the limits of joint speed, as those they were made from.

    A path that does not is one of poses: it jumps between postures, and nobody can drive it.
    """
    good = [
        (np.abs(np.diff(path, axis=0)) <= plant.velocity_limits * np.diff(problem.t_s)[:, None]).all()
        for problem, path in zip(problems, paths, strict=True)
    ]
    return float(np.mean(good))
