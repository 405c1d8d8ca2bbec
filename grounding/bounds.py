"""Thresholds that several modules of the grounding share; one that a single module uses stands there.

Where a bound was set on data its docstring or section names them, with the command. All others were chosen by hand on
own renders; no search is on record. Agreements are shares of the robot's contours that lie on image edges. Pixels are
those of an image 384 px wide.
"""

import numpy as np

GOOD_M = 0.010
"""Error of a position whose probability the confidence is [m]."""
GOOD_RAD = float(np.deg2rad(5.0))
"""The same of a rotation [rad]."""
SAMPLED_FRAMES = 5
"""Frames that decide on a video: on its look, its region, its camera."""

# Anomalies. Set on planted faults in home renders of seen assets, checked on clean ones:
# `python -m benchmarks planted-videos --out faulty`, then `python -m benchmarks evaluate faulty`.

ABSENT_CELLS = 50.0
"""Cells explained by the posed gripper below which it is absent: a third of a gripper explains 100."""
MOVING_PX = 1.2
"""Least motion of the background of a moving camera [px]."""
FIXED_PX = 0.5
"""Motion of the background below which a camera counts as fixed [px]."""
COMPENSABLE_PX = 8.0
"""Largest motion that is compensated where the camera cannot be followed: beyond it the base frame is lost [px]."""

# Cameras. Bounds of an estimate were set on renders of another renderer, all are checked on right and wrong cameras:
# `python -m benchmarks cameras FOLDER --out OUT --presented plain,named,mirrored,short_focal,long_focal`; no wrong one
# may be accepted. `kinebench_drake.camera.CONFIRMED` belongs to them.

AGREEMENT = 0.45
"""Least agreement with a camera that no other explains better."""
BASE_AGREEMENT = 0.4
"""Least agreement of the base link with an estimated camera, or with one that is known by name."""
LEAD = 0.08
"""Least lead of an estimated camera over another one, and of a turn of the base over another turn."""

# Tracking. The confidence is fitted by `python -m training calibrate` on three renderers that the network was not
# trained on. Bounds are checked by `python -m benchmarks evaluate` on home renders, by `footage` on others' videos.

TRACKED_CONFIDENCE = 0.3
"""Least confidence of a tracked frame."""
MIN_CONFIDENCE = 0.02
"""Least confidence of a detection that is a gripper."""
MIN_TRACKED = 2
"""Fewest frames with a pose: a path needs two."""
EDGE_AGREEMENT = 0.4
"""Least agreement of a posture that edges confirm."""
CONFIRMATION = 0.6
"""Agreement from which on the edges confirm the network's poses (median), or the shape of a hand, without a fit."""
FAR_M = 0.02
"""Largest change of a pose by a fit to edges alone that does not contradict the network's poses, and by a fit to cells
and edges together [m]."""
BEST_QUANTILE = 0.75
"""Quantile of the frames' agreements that stands for the best frames, which others are compared with."""
MAX_ANGLE_RAD = float(np.deg2rad(20.0))
"""Largest angle between a hand, or a flange, posed by its arm and by itself [rad]."""
SHARP_M = 0.004
"""Standard deviation of a width up to which it is trusted as measured [m]."""
