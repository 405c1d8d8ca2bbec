"""Recording of one track for the Rerun viewer (extra `rerun`): arm, path of the gripper, and curves over time."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinebench_drake.errors import SetupError
from kinebench_drake.geometry import Array
from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.report.replay_scene import COLORS, LinkMesh, pose_links, posed_frames
from kinebench_drake.report.timeline import frame_states
from kinebench_drake.results.row import SampleRow
from kinebench_drake.results.trackfile import TrackFile


def record_track(plant: ArmPlant, meshes: Sequence[LinkMesh], row: SampleRow, file: TrackFile) -> bytes:
    """Return the bytes of an rrd file, with the time of the track `t` [s] and poses in B [m].

    Raises:
        SetupError: the package rerun-sdk is missing.
    """
    try:
        import rerun as rr
    except ImportError:
        raise SetupError("recordings need the package rerun-sdk: pip install rerun-sdk") from None
    recording = rr.RecordingStream("kinebench-drake", recording_id=row.id, send_properties=False)
    recording.disable_timeline("log_time")  # times of this program, not of the track
    memory = recording.memory_recording()
    t_s, X_BG, colors = file.track.t_s, file.track.X_BG, [COLORS[state] for state in frame_states(row, file)]

    def move(path: str, frames: NDArray[np.bool_], X: Array) -> None:
        columns = rr.Transform3D.columns(translation=X[:, :3, 3], mat3x3=X[:, :3, :3])
        recording.send_columns(path, [rr.TimeColumn("t", duration=t_s[frames])], columns)

    posed, solved = posed_frames(file), np.asarray(np.isfinite(file.q).all(axis=1), dtype=bool)
    recording.log("base", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    points = rr.Points3D(X_BG[posed, :3, 3], colors=np.array(colors)[posed], radii=0.004)
    recording.log("base/path", points, static=True)
    recording.log("base/tcp", rr.TransformAxes3D(0.06), static=True)
    move("base/tcp", posed, X_BG[posed])
    for mesh, X in zip(
        meshes, pose_links(plant, meshes, file.q[solved], file.track.finger_width_m[solved]), strict=True
    ):
        surface = rr.Mesh3D(vertex_positions=mesh.vertices, triangle_indices=mesh.faces, albedo_factor=(220, 222, 226))
        recording.log(f"base/arm/{mesh.link}", surface, static=True)
        move(f"base/arm/{mesh.link}", solved, X)
    curves = {"confidence": file.track.confidence, "finger_width_m": file.track.finger_width_m, **file.curves}
    for name, values in curves.items():
        for joint, column in enumerate(np.atleast_2d(values.T), 1):
            path = f"curves/{name}" if values.ndim == 1 else f"curves/{name}/joint{joint}"
            recording.send_columns(path, [rr.TimeColumn("t", duration=t_s)], rr.Scalars.columns(scalars=column))
    return bytes(memory.drain_as_bytes())
