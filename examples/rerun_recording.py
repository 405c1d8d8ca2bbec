"""Write the track of a sample as a recording for the Rerun viewer (https://rerun.io): arm, path and curves.

python rerun_recording.py results/tracks/ID.npz ID.rrd      (pip install rerun-sdk)
"""

import sys
from pathlib import Path

import numpy as np
import rerun as rr

from kinebench_drake.kinematics.plant import ArmPlant
from kinebench_drake.report.replay import link_meshes
from kinebench_drake.report.replay_scene import PATH_COLOR, pose_links, posed_frames
from kinebench_drake.results.trackfile import read_track
from kinebench_drake.segments import finite_rows

source = Path(sys.argv[1])
file = read_track(source)
track = file.track
recording = rr.RecordingStream("kinebench-drake", recording_id=source.stem, send_properties=False)
recording.disable_timeline("log_time")  # times of this program, not of the track
memory = recording.memory_recording()


def move(path, frames, X):
    """Log poses (N, 4, 4) in the base frame at some frames of the track."""
    columns = rr.Transform3D.columns(translation=X[:, :3, 3], mat3x3=X[:, :3, :3])
    recording.send_columns(path, [rr.TimeColumn("t", duration=track.t_s[frames])], columns)


posed = posed_frames(file)
solved = finite_rows(file.q)
recording.log("base", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
recording.log("base/path", rr.Points3D(track.X_BG[posed, :3, 3], colors=PATH_COLOR, radii=0.004), static=True)
recording.log("base/tcp", rr.TransformAxes3D(0.06), static=True)
move("base/tcp", posed, track.X_BG[posed])
plant = ArmPlant()
meshes = link_meshes(plant)
for mesh, X in zip(meshes, pose_links(plant, meshes, file.q[solved], track.finger_width_m[solved]), strict=True):
    surface = rr.Mesh3D(vertex_positions=mesh.vertices, triangle_indices=mesh.faces, albedo_factor=(220, 222, 226))
    recording.log(f"base/arm/{mesh.link}", surface, static=True)
    move(f"base/arm/{mesh.link}", solved, X)
for name, values in {"confidence": track.confidence, "finger_width_m": track.finger_width_m, **file.curves}.items():
    for joint, column in enumerate(np.atleast_2d(values.T), 1):
        path = f"curves/{name}" if values.ndim == 1 else f"curves/{name}/joint{joint}"
        recording.send_columns(path, [rr.TimeColumn("t", duration=track.t_s)], rr.Scalars.columns(scalars=column))
Path(sys.argv[2]).write_bytes(memory.drain_as_bytes())
