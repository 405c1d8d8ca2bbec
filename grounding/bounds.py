"""Bounds that decide: which track is trusted, which camera counts, what is an anomaly. Each stands here alone.

Where a bound was set on data its section or line names them, with the command. All others were chosen by hand on own
renders; no search is on record. Settings of solvers, and constants of physics and formats, stand where they are used.
Agreements are shares of the robot's contours that lie on image edges. Pixels are those of an image 384 px wide.
"""

import numpy as np

GOOD_M = 0.010
GOOD_RAD = float(np.deg2rad(5.0))
"""Errors [m, rad] whose probability the confidence is."""
SAMPLED_FRAMES = 5
"""Frames that decide on a video: on its look, its region, its camera."""
MAJORITY = 0.5
"""Share that is most: of features that a motion of the camera explains, of frames in which it is known, of poses whose
arm agrees in a familiar video or with a followed camera, of frames that an estimated camera explains, of cells that
agree with known postures."""

# Anomalies. Set on planted faults in home renders of seen assets, checked on clean ones:
# `python -m benchmarks planted-videos --out faulty`, then `python -m benchmarks anomalies clean faulty`.

SCORE_SPREAD = 0.06
SCORE_SPREAD_ELSEWHERE = 0.25
"""Relative distance of a detector's score from its bound, 1, within which it decides nothing, in familiar videos and in
others: between float32 and bfloat16 scores near the bound differ by up to a factor of 1.12 there, and of 1.5 here
(`python -m benchmarks precision`)."""
PRESENCE_FRAMES = 3
"""Least number of frames of a vanished or a second gripper; fewer may be an occlusion."""
ABSENT_CONFIDENCE = 0.01
ABSENT_CELLS = 50.0
"""Confidence, or cells explained by the posed gripper, below which it is absent: a third of a gripper explains 100."""
ABSENT_AGREEMENT = 0.2
"""Share of the hand's contours on image edges below which they lie there by chance, as where there is no hand."""
HIDDEN_SHARE = 0.4
"""Share of a gripper's core behind links of the arm from which on it may be hidden altogether."""
MEASURABLE_SHARE = 0.9
"""Least share of the frames with a fair position, apart from those without a gripper, of an unfamiliar video in which a
gripper that is not found has vanished."""
DUPLICATE_SHARE = 0.2
"""Least share of a second gripper's cells."""
FAIR_CONFIDENCE = 0.1
GOOD_CONFIDENCE = 0.5
"""Least confidence at which a frame's position and misfit count, and at which size, contour and jumps do: a deformed
gripper has a low one, and an error of a few degrees falsifies the size."""
MAX_SIDE_COSINE = 0.4
MAX_CONTOUR_COSINE = 0.85
"""Largest cosine between fingers' axis and line of sight at which the size counts, and at which the contour does: seen
edge-on a gripper is narrow, and its fingers hide each other. From 0.4 on the size of clean hands is biased (11 videos
of suite 2, unseen)."""
SIZE_FRAMES = 20
"""Fewest frames that measure the size of a hand."""
MISFIT = 0.02
EXCESS = 1.45
"""Least relative misfit of the shape of a deformation, and its least residual against any rigid gripper over the usual
one of the video. Both must hold: the misfit alone gives false alarms where the gripper is seen edge-on."""
USUAL_RESIDUAL = 0.6
"""Greatest usual residual of a video: that of videos without a deformation [standard deviations]."""
SHAPE_FRAMES = 5
"""Frames of the running median of the misfit; an anomaly by contours lasts for as many."""
CONTOUR_SIZE = 0.06
"""Least relative error of the size by contours of a hand that is too large or small: in clean videos of another
simulator it is up to 0.051 (`python -m benchmarks footage`)."""
CONTOUR_CHANGE = 0.12
"""Least relative change of the hand's contour of a deformation in an unfamiliar look."""
CONTOUR_GAIN = 0.18
"""Least increase of the contour's agreement by either."""
CONTOUR_WINDOW = 9
"""Frames of the running median of the change."""
TELEPORT_M = 0.04
TELEPORT_CONTRAST = 4.0
"""Least length of a teleport [m], and least ratio to the median jump length of the path around it."""
FREEZE_FRAMES = 5
FREEZE_SPEED_M_S = 0.035
FREEZE_JUMP = 2.0
"""Least number of still frames of a freeze, least speed of the gripper before it [m/s], and least length of the step
that ends it, over the longer of the steps before the freeze and after that step."""
STILL_LEVELS = 4.0
STILL_M = 0.004
"""A frame is still if all but 0.5 % of its pixels, slightly blurred, change by less than this, of 255; motion of the
track between still frames by noise of codec and network [m]."""
WIDTH_SIGMA_M = 0.006
"""Largest standard deviation of a width that counts for an anomaly [m]."""
WIDTH_FAULT_M = 0.015
"""Least excess of a width over the largest, or amplitude of alternate opening and closing over four frames [m]."""
MOVING_PX = 1.2
FIXED_PX = 0.5
"""Least motion of the background of a moving camera [px], and below which it counts as fixed."""
CLEAR_PX = 2.0
COMPENSABLE_PX = 8.0
"""Motion from which on a camera is followed before anything else is measured, and largest one that is compensated where
it cannot be followed: beyond it the base frame is lost [px]."""
MOTION_QUANTILE = 0.3
"""Quantile of the features' displacements that is the motion: up to this share may be moved against it by the robot, up
to the rest may be moved by the robot while the camera is fixed."""
MOTION_FEATURES = 12
MOTION_FRAMES = 2
"""Least numbers of features and of consecutive frames of a motion: a frame may have lost its features to the robot."""

# Cameras. Bounds of an estimate were set on renders of another renderer, all are checked on right and wrong cameras:
# `python -m benchmarks cameras FOLDER --out OUT --presented plain,named,mirrored,short_focal,long_focal`; no wrong one
# may be accepted. `kinebench_drake.camera.CONFIRMED` belongs to them.

AGREEMENT = 0.45
SURE_AGREEMENT = 0.68
"""Least agreement with a camera that no other explains better, and from which on no other reading of the picture is
tried, not even a mirrored one."""
CONTRADICTING = 0.5
CLEARLY = 0.1
"""Least agreement with another camera or reading that contradicts the assumed one, and its least lead."""
LARGE_M = 0.03
LARGE_RAD = GOOD_RAD
"""Displacement of the gripper by the other camera from which on there is no verdict, and of the initial state from a
confident estimate of the first frame, from which on it is not used [m, rad]."""
ARM_AGREEMENT = 0.64
BASE_AGREEMENT = 0.4
"""Least agreements of hand and arm, and of the base link, with an estimated camera: no wrong camera of own renders
reaches both."""
ALIGNED_AGREEMENT = 0.5
ALIGNED_BASE_AGREEMENT = 0.3
"""The same where lines of the surroundings run along the axes of the base: of 43 renders by two other programs they do
so with 18 right cameras, and with one whose focal length is wrong by a quarter (0.48 of the arm's contours)."""
LEAD = 0.08
ALIGNED_LEAD = 0.03
"""Least lead of an estimated camera over another one, and of a turn of the base over another turn; of aligned cameras
that agree by `ARM_AGREEMENT`."""
GRIPPER_SIGMA_M = 0.02
GRIPPER_SIGMA_RAD = float(np.deg2rad(3.0))
"""Greatest standard deviations of the gripper in the base frame, due to its camera, of a verdict [m, rad]."""
ASKEW_LOSS = 0.2
"""Loss of the base's agreement at which lines along its axes are those of something askew."""
LEAST_EXPLAINED = 0.75
"""Share of the frames with the robot below which another lens is unlikely."""
FRAME_SHARE = 0.75
"""Least share of the agreement of the better frames, of a frame that a camera is fitted to."""
RECOGNITION_LEAD = 0.05
"""Least lead of a camera known by name in the agreements of arm and base together, and how much more of the arm's a
camera may have that is freed from its place. Checked on clips at stock cameras: `benchmarks/mujoco_clips.py stock`,
then `python -m benchmarks cameras stock --out OUT --presented plain`."""
LIKELY_COST = 6.0
LIKELY_COST_LEAD = 0.8
"""Mean error of the cells (`Hypothesis.cost`) up to which a named camera comes into question, and its lead."""
FOCAL_LIMIT = 0.05
POSITION_LIMIT_M = 0.05
ROTATION_LIMIT_RAD = GRIPPER_SIGMA_RAD
"""Standard deviations of a calibration that are errors: of the focal length, relative, of the camera's place [m], and
of its turn [rad]."""
MISFIT_LIMIT_PX = 6.0
"""The same of the gripper's median error in a fit to cells [px]."""
WARNING_SHARE = 0.4
"""Share of these from which on there is a warning."""
MIN_MOTION_M = 0.1
MIN_DEPTH_RATIO = 1.25
"""Distance between hand positions below which a video shows one posture [m]; ratio of farthest to nearest depth below
which perspective hardly determines the focal length."""
FRAMING_CORRELATION = 0.75
"""Least correlation of a first frame that shows the conditioning image."""
BAR_LEVELS = 7.0
"""Grey levels of 255 by which a bar may vary, over its area and in time, and by which the image beside it differs."""

# Tracking. The confidence is fitted by `python -m training calibrate` on three renderers that the network was not
# trained on. Bounds are checked by `python -m benchmarks evaluate` on home renders, by `footage` on others' videos.

TRACKED_CONFIDENCE = 0.3
MIN_CONFIDENCE = 0.02
"""Least confidence of a tracked frame, and of a detection that is a gripper."""
MIN_TRACKED = 2
HAND_SHARE = 0.1
"""Fewest frames with a pose, since a path needs two, and least share of the frames in which a hand counts as seen."""
EDGE_AGREEMENT = 0.4
"""Least agreement of a posture that edges confirm."""
GOOD_OVERLAP = 0.8
"""Overlap of the mask from which on a pose whose arm agrees is not doubtful."""
MIN_COVERAGE = 0.6
"""Least share of a gripper fitted to edges that shows the robot: without it 30 % of absent ones are tracked."""
CONFIRMATION = 0.6
"""Agreement from which on the edges confirm the network's poses (median), or the shape of a hand, without a fit."""
SMALL_M = 0.0025
"""Median change of a pose by a fit to edges alone up to which they confirm the network's poses, too [m],"""
FAR_M = 0.02
FAR_GAIN = 0.18
"""and above which the change, or the gain of agreement by it, contradicts them. Largest change by a fit to cells and
edges together, likewise."""
FIRST_M = 0.015
FIRST_RAD = float(np.deg2rad(6.0))
"""Largest deviation of a stated initial state from a confident estimate of the first frame, to be used."""
MISSED_SHARE = 0.1
"""Largest share of frames of a familiar video that are reached by following the arm alone."""
SURE_SHARE = 0.8
"""Mean confidence of the poses below which a familiar video is tried as an unfamiliar one."""
BEST_QUANTILE = 0.75
BEST_SHARE = 0.9
"""Frames that agree nearly as well as the best ones are not tried again: quantile of these, and share of it."""
MAX_CONSISTENCY_PX = 6.0
"""Largest median distance between links as estimated and as posed of an arm that agrees [px]."""
MAX_ACROSS_M = 0.025
MAX_ALONG_M = 0.08
MAX_ANGLE_RAD = float(np.deg2rad(20.0))
"""Largest deviation of a hand posed by an arm that agrees from the fit of the hand alone, across and along the line of
sight [m], and its angle [rad]."""
SHARPENING_GROWTH_PX = 1.0
"""Largest increase of the links' distance by such a fit [px]: beyond, the edges are those beside the right ones."""
MAX_GROWTH = 1.4
MAX_GROWTH_SIGMAS = 0.3
"""Largest increase of the hand's residual by the arm: factor, and summand."""
SHAPE_CHANGE = 0.35
"""Change of the hand's shape by a fit that has failed."""
NEIGHBOUR_LEAD = 0.05
"""Least lead of a neighbour's agreement that makes its posture of the flange the better one."""
LOST_SHARE = 0.8
MOUNT_LEAD = 10.0
"""Share of the agreement of a frame below which the flange was not followed from it, and log-likelihood by which the
mount of a gripper leads clearly."""
ON_BASE_M = 0.06
BASE_LOSS = 0.1
"""Largest displacement [m] of a flange by the base of its arm, and loss of agreement."""
SHARP_M = 0.004
BLIND_M = 0.010
UNKNOWN_M = 0.015
"""Standard deviations of a width [m] up to which it is trusted as measured, from which on it is ignored, and above
which it is unknown after all. Larger ones have correlated errors: fingers that hide each other are confused."""
FOLLOWED_RAD = float(np.deg2rad(15.0))
FOLLOWED_M = 0.15
FOLLOWED_ZOOM = 0.2
"""Largest rotation, distance and relative zoom from the first camera that are followed."""
PATH_FEATURES = 16
PATH_GAIN = 0.05
MIN_ON_TABLE = 0.3
"""Least number of features of a frame that follow the camera, least increase of their explained share by a less simple
way of moving, and least share of those with depth that lie on the table top and make it the scale."""
