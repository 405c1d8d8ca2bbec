import numpy as np
import pytest

from kinebench_drake.geometry import make_pose
from kinebench_drake.results.row import Status
from kinebench_drake.results.trackfile import TrackFile
from kinebench_drake.track import GripperTrack, IkStatus
from tests.rows import make_row

N = 10
JOINTS = [f"arm_joint{k}" for k in range(1, 8)]
LIMITS = {
    "joints": JOINTS,
    "position": {"lower": [-2.0] * 7, "upper": [1.0] * 7},
    "velocity": [2.0] * 7,
    "acceleration": None,
    "jerk": [100.0] * 7,
    "torque": [80.0] * 4 + [None] * 3,
}


@pytest.fixture
def judged():
    """A row with limits, and changes to it."""

    def make(**changes):
        fields = {"feasible": True, "details": {"limits": LIMITS}, **changes}
        return make_row(
            id="a", video="", task=None, model=None, status=Status.OK, reason=None, content_hash="0", **fields
        )

    return make


@pytest.fixture
def file():
    """A track whose joint 3 is fastest at frame 4, of which frame 7 is not tracked."""

    def make(**curves):
        X = make_pose(np.broadcast_to(np.eye(3), (N, 3, 3)), np.linspace(0.0, 1.0, 3 * N).reshape(N, 3))
        X[7] = np.nan
        on = np.isfinite(X[:, 0, 0])
        velocity = np.full((N, 7), 0.1)
        velocity[4, 2] = -1.9
        q = np.zeros((N, 7))
        q[2, 5] = -1.7
        status = [IkStatus.OK] * N
        status[7] = IkStatus.NOT_TRACKED
        return TrackFile(
            track=GripperTrack(
                t_s=1.0 + np.arange(N) * 0.1,
                X_CH=X,
                X_BG=X,
                tracked=on,
                confidence=on * 1.0,
                finger_width_m=np.full(N, np.nan),
            ),
            q=q,
            ik_ok=on,
            status=tuple(status),
            curves={"velocity": velocity, "table_distance_m": np.linspace(0.3, 0.012, N), **curves},
        )

    return make
