"""Cubic B-splines in time, as sparse matrices on their control points.

A B-spline and its derivatives lie within the hulls of their control points: bounds on these hold at all times. For
cubic splines they are hardly stricter than bounds on the curve: control points of jerk and acceleration are its values
in the spans and at the knots; those of velocity and position lie outside the curve by the order of the knot spacing
squared (C. de Boor, "A Practical Guide to Splines", Springer 1978, chapters IX and X).
"""

from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import diags, identity
from scipy.sparse.linalg import splu

from kinebench_drake.geometry import Array

ORDER = 4
"""Cubic: acceleration is continuous, jerk is bounded."""
_DEGREE = ORDER - 1

# spans allowed, times the median of the frames' spacing
_SHORTEST = 0.25
_LONGEST = 2.0


class SplineBasis:
    """Clamped cubic B-splines on a sequence of break points."""

    def __init__(self, breaks_s: Array) -> None:
        """Set the break points (K,) [s], increasing, the first 0."""
        self.breaks_s = breaks_s
        """(K,) ends of the polynomial pieces [s]."""
        self.knots = np.concatenate([np.repeat(breaks_s[0], _DEGREE), breaks_s, np.repeat(breaks_s[-1], _DEGREE)])
        """(n + 4,) knots [s], the first and last repeated four times."""
        self.size = len(self.knots) - ORDER
        """Number n of control points."""

    @classmethod
    def through(cls, t_s: Array) -> "SplineBasis":
        """Return a basis with a break at every frame `t_s` (T,) [s].

        Breaks less than a quarter of the median spacing apart are merged; gaps of more than twice the median get
        additional breaks, so that the motion through them is free.
        """
        spacing = float(np.median(np.diff(t_s)))
        kept = [float(t_s[0])]
        for t in t_s[1:]:
            parts = int(np.ceil((t - kept[-1]) / (_LONGEST * spacing)))
            if t - kept[-1] >= _SHORTEST * spacing:
                kept += list(np.linspace(kept[-1], t, parts + 1)[1:])
        if kept[-1] < t_s[-1]:  # the last frame is a break in any case
            kept[-1:] = [float(t_s[-1])] if len(kept) > 1 else [kept[0], float(t_s[-1])]
        return cls(np.array(kept))

    def refine(self) -> "SplineBasis":
        """Return the basis with every span halved; its curves include all curves of this one."""
        middle = 0.5 * (self.breaks_s[1:] + self.breaks_s[:-1])
        return SplineBasis(np.sort(np.concatenate([self.breaks_s, middle])))

    def values(self, t_s: Array) -> Any:
        """Return the sparse matrix (N, n) from control points to the curve at times `t_s` (N,) [s]."""
        return BSpline.design_matrix(np.clip(t_s, self.knots[0], self.knots[-1]), self.knots, _DEGREE)

    @cached_property
    def derivatives(self) -> tuple[Any, ...]:
        """Sparse matrices (n - k, n) from control points to those of the k-th derivative, k = 0..3.

        De Boor, chapter X, equation (12): c'_i = (c_{i+1} - c_i) * degree / (knot_{i+degree+1} - knot_{i+1}).
        """
        matrices = [identity(self.size, format="csr")]
        for k in range(1, ORDER):
            degree = ORDER - k
            size = self.size - k
            span = self.knots[k + degree : k + degree + size] - self.knots[k : k + size]
            difference = diags([-degree / span, degree / span], [0, 1], shape=(size, size + 1))
            matrices.append((difference @ matrices[-1]).tocsr())
        return tuple(matrices)

    def centres(self, derivative: int) -> Array:
        """Return the Greville abscissae (n - k,) [s] of the control points of the k-th derivative."""
        degree = _DEGREE - derivative
        first = derivative + 1
        if degree == 0:
            return np.asarray(0.5 * (self.breaks_s[1:] + self.breaks_s[:-1]))
        windows = [self.knots[first + i : first + i + self.size - derivative] for i in range(degree)]
        return np.asarray(np.mean(windows, axis=0))

    def fit(self, t_s: Array, q: Array, stiffness: float = 1e-8) -> Array:
        """Fit control points (n, D) to values `q` (T, D) at `t_s` (T,): least squares, then least acceleration.

        Args:
            t_s: (T,) times [s].
            q: (T, D) values.
            stiffness: weight of the squared accelerations, each times its span squared, relative to the squared
                residuals; small enough not to change the residuals, it makes the solution unique.
        """
        B = self.values(t_s)
        D = self.derivatives[2] * float(np.median(np.diff(self.breaks_s))) ** 2
        return np.asarray(splu((B.T @ B + stiffness * (D.T @ D)).tocsc()).solve(B.T @ q))

    def evaluate(self, control: Array, t_s: Array, derivative: int = 0) -> Array:
        """Return a derivative (N, D) of the curve with control points `control` (n, D) at `t_s` (N,) [s]."""
        return np.asarray(BSpline(self.knots, control, _DEGREE)(t_s, derivative))
