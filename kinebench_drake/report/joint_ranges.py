"""Where each joint is within its range over time: a lane a joint, its limits the lane's edges."""

from collections.abc import Iterator, Sequence

import numpy as np
from markupsafe import Markup, escape

from kinebench_drake.geometry import Array
from kinebench_drake.report.frames import JointLimits
from kinebench_drake.report.plot import pieces, ticks
from kinebench_drake.runs import runs

NEAR = 0.1
"""Margin below which a joint is near its limit, as a share of half its range."""
_WIDTH, _LEFT, _RIGHT, _LANE, _TALL, _BOTTOM = 430.0, 44.0, 44.0, 25.0, 21.0, 20.0
_BEYOND = 1.15
"""Half ranges from the middle up to which a joint's line is drawn."""


def draw_joint_ranges(t_s: Array, q: Array, limits: JointLimits, names: Sequence[str]) -> Markup | None:
    """The picture as a `<figure>`; None if the limits or all angles are unknown.

    A joint's line runs between the lower edge of its lane, its lower limit, and the upper one; on the right stands
    its least margin: distance to the limit over half the range, negative outside.

    Args:
        t_s: (T,) time [s].
        q: (T, 7) joint angles [rad]; NaN where unknown.
        limits: the joints' ranges.
        names: short names of the joints.
    """
    if limits.position is None or not np.isfinite(q).any():
        return None
    lower, upper = limits.position
    place = (q - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    height = _LANE * len(names) + _BOTTOM
    span = float(t_s[-1] - t_s[0]) or 1.0
    x = _LEFT + (t_s - t_s[0]) / span * (_WIDTH - _LEFT - _RIGHT)
    parts = [f'<svg viewBox="0 0 {_WIDTH:.0f} {height:.0f}" role="img" aria-label="Joints within their ranges">']
    for time in ticks(float(t_s[0]), float(t_s[-1])):
        at = _LEFT + (time - float(t_s[0])) / span * (_WIDTH - _LEFT - _RIGHT)
        parts.append(f'<text class="tick time" x="{at:.1f}" y="{height - 5:.1f}">{time:.4g}</text>')
    for j, name in enumerate(names):
        top = 1.0 + j * _LANE
        parts.append(
            f'<rect class="rail" x="{_LEFT:.0f}" y="{top:.1f}" width="{_WIDTH - _LEFT - _RIGHT:.0f}" '
            f'height="{_TALL:.0f}"><title>{escape(_told(limits, j))}</title></rect>'
            f'<text class="tick" x="{_LEFT - 6:.0f}" y="{top + 14.5:.1f}">{escape(name)}</text>'
        )
        parts += _lane(x, t_s, place[:, j], top)
    parts.append("</svg>")
    key = '<span class="lamp near">near a limit</span><span class="lamp violation">beyond it</span>'
    caption = f"<figcaption>Joints within their ranges; right: least margin{key}</figcaption>"
    return Markup(f'<figure class="ranges">{caption}{"".join(parts)}</figure>')


def _lane(x: Array, t_s: Array, place: Array, top: float) -> Iterator[str]:
    """Shades, line and least margin of one joint; `place` is -1 at its lower limit and 1 at its upper one."""
    known = np.isfinite(place)
    if not known.any():
        return
    margin = 1.0 - np.abs(np.where(known, place, 0.0))
    half = 0.5 * (x[-1] - x[0]) / max(len(x) - 1, 1)
    for css, mask in (("near", (margin < NEAR) & (margin >= 0.0)), ("past", margin < 0.0)):
        for run in runs(mask & known):
            reach, times = x[run], t_s[run]
            left, right = max(reach[0] - half, x[0]), min(reach[-1] + half, x[-1])
            words = f"margin {margin[run].min():.3f}, {times[0]:.2f} to {times[-1]:.2f} s"
            yield (
                f'<rect class="shade-{css}" x="{left:.1f}" y="{top:.1f}" width="{max(right - left, 1.5):.1f}" '
                f'height="{_TALL:.0f}"><title>{words}</title></rect>'
            )
    middle, scale = top + 0.5 * _TALL, 0.5 * _TALL
    for piece in pieces(x, np.clip(place, -_BEYOND, _BEYOND)):
        points = [f"{at:.1f},{middle - value * scale:.1f}" for at, value in piece]
        if len(points) == 1:
            at_x, at_y = points[0].split(",")
            yield f'<circle class="dot c0" cx="{at_x}" cy="{at_y}" r="1.5"/>'
        else:
            yield f'<polyline class="curve c0" points="{" ".join(points)}"/>'
    least = float(margin[known].min())
    css = " past" if least < 0.0 else " near" if least < NEAR else ""
    yield f'<text class="tick margin{css}" x="{_WIDTH - _RIGHT + 6:.0f}" y="{top + 14.5:.1f}">{least:.2f}</text>'


def _told(limits: JointLimits, j: int) -> str:
    if limits.position is None:
        return limits.joints[j]
    low, high = (float(end[j]) * 180.0 / np.pi for end in limits.position)
    return f"{limits.joints[j]}: {low:.1f}° to {high:.1f}°"
