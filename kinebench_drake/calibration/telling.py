"""A calibration in words."""

import numpy as np

from kinebench_drake.calibration.calibration import Calibration


def lines(calibration: Calibration) -> list[str]:
    """What a user reads of it."""
    c, camera = calibration, calibration.camera
    place = ", ".join(f"{1e3 * x:.0f}" for x in camera.X_BC[:3, 3])
    fov = np.rad2deg(2 * np.arctan(camera.width / 2 / camera.fx))
    sure = f" +- {100 * c.focal_sigma:.1f} %" if c.focal_free else ", given"
    told = [
        f"from: {c.source}; {len(c.frames)} frames, {sum(c.part_cells.values())} cells of the robot "
        f"(gripper {c.part_cells['gripper']}, arm {c.part_cells['arm']}, base {c.part_cells['base']})",
        f"camera in the base frame: {place} mm, +- {1e3 * c.position_sigma_m:.0f} mm, "
        f"{np.rad2deg(c.rotation_sigma_rad):.2f} degrees",
        f"focal length: {camera.fx:.1f} px{sure} (field of view {fov:.1f} degrees across {camera.width} px)",
        f"residual: {c.residual_px:.2f} px rms; medians "
        + ", ".join(f"{name} {px:.1f}" for name, px in c.part_px.items() if np.isfinite(px)),
    ]
    if len(c.spread_m) > 1:
        told.append(
            f"single frames: {1e3 * np.median(c.spread_m):.0f} mm and {np.rad2deg(np.median(c.spread_rad)):.2f} "
            f"degrees from it (median of {len(c.spread_m)}), 95 %: {1e3 * np.quantile(c.spread_m, 0.95):.0f} mm, "
            f"{np.rad2deg(np.quantile(c.spread_rad, 0.95)):.2f} degrees"
        )
    told.append(
        f"the robot is seen {c.depth_m[0]:.2f} to {c.depth_m[1]:.2f} m away, the hand moves {1e3 * c.motion_m:.0f} mm"
    )
    return [*told, *(f"warning: {warning}" for warning in c.warnings)]
