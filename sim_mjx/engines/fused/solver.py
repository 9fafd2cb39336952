"""Newton's method for MuJoCo's constraint problem, and the implicit integrator's linear system.

A trial stops when its own gradient is small; as each has a thread, it waits for none but those of its warp.
"""

from functools import lru_cache
from typing import Any

import warp as wp

from sim_mjx.engines.fused.constraints import Pairs
from sim_mjx.engines.fused.dynamics import Vectors
from sim_mjx.engines.fused.model import inverse_root, reciprocal, shapes

SEARCHES = wp.constant(8)  # steps of a line search at most
SMALLEST = wp.constant(1e-30)
FLAT = wp.constant(0.01)  # of the initial slope: where a line search ends


@wp.func
def cone_force(missing: wp.vec3, weight: wp.vec3, cone: wp.vec3) -> wp.vec3:
    """The force of a contact whose rows miss their reference accelerations by so much."""
    mu = cone[0]
    normal = missing[0] * cone[0]
    one = missing[1] * cone[1]
    two = missing[2] * cone[2]
    square = one * one + two * two
    inverse = inverse_root(wp.max(square, SMALLEST))
    across = square * inverse
    if normal >= mu * across:
        return wp.vec3(0.0)
    if mu * normal + across <= 0.0:
        return -wp.cw_mul(weight, missing)
    push = weight[0] * (mu * across - normal) * reciprocal(mu * (1.0 + mu * mu))
    return push * wp.vec3(1.0, -one * inverse * cone[1], -two * inverse * cone[2])


@wp.func
def cone_slope(missing: wp.vec3, weight: wp.vec3, cone: wp.vec3) -> wp.mat33:
    """By how much the force falls per missing acceleration: the second derivative of the contact's cost."""
    mu = cone[0]
    normal = missing[0] * cone[0]
    one = missing[1] * cone[1]
    two = missing[2] * cone[2]
    square = one * one + two * two
    inverse = inverse_root(wp.max(square, SMALLEST))
    across = square * inverse
    if normal >= mu * across:
        return wp.mat33(0.0)
    if mu * normal + across <= 0.0:
        return wp.diag(weight)
    scale = weight[0] * reciprocal(mu * mu * (1.0 + mu * mu))
    bend = mu * (mu * across - normal) * inverse  # of the two tangents' part
    x = one * inverse
    y = two * inverse
    a = mu * mu * cone[1] * x
    b = mu * mu * cone[2] * y
    xx = cone[1] * cone[1] * (mu * mu * x * x + bend * y * y)
    yy = cone[2] * cone[2] * (mu * mu * y * y + bend * x * x)
    xy = cone[1] * cone[2] * x * y * (mu * mu - bend)
    return scale * wp.mat33(mu * mu, -a, -b, -a, xx, xy, -b, xy, yy)


@lru_cache
def newton(n: int) -> Any:
    """The solver for ``n`` joints."""
    column, square, wide = shapes(n)

    @wp.func
    def factor(lower: square) -> square:
        """Cholesky's factor of a matrix by its lower half, with the reciprocals of its diagonal."""
        for j in range(n):
            for i in range(j, n):
                rest = lower[i, j]
                for k in range(j):
                    rest -= lower[i, k] * lower[j, k]
                if i == j:
                    lower[j, j] = inverse_root(rest)
                else:
                    lower[i, j] = rest * lower[j, j]
        return lower

    @wp.func
    def solved(factor: square, right: column) -> column:
        """The solution of a linear system by its matrix's factor."""
        for i in range(n):
            for k in range(i):
                right[i] -= factor[i, k] * right[k]
            right[i] = right[i] * factor[i, i]
        for back in range(n):
            i = n - 1 - back
            for k in range(i + 1, n):
                right[i] -= factor[k, i] * right[k]
            right[i] = right[i] * factor[i, i]
        return right

    @wp.func
    def seen(own: wide, motion: column) -> wp.vec3:
        """A joint motion in a contact's frame."""
        out = wp.vec3(0.0)
        for i in range(n):
            out += wp.vec3(own[0, i], own[1, i], own[2, i]) * motion[i]
        return out

    @wp.func
    def slope_along(
        at: float, quadratic: wp.vec2, count: int, missing: Vectors, moved: Vectors, weights: Vectors, cones: Vectors,
        limits: Pairs, limit_weights: Pairs, qacc: column, step: column,
    ) -> wp.vec2:  # fmt: skip
        """First and second derivative of the cost along a step."""
        first = quadratic[0] + at * quadratic[1]
        second = quadratic[1]
        for c in range(count):
            there = missing[c] + at * moved[c]
            first -= wp.dot(cone_force(there, weights[c], cones[c]), moved[c])
            second += wp.dot(moved[c], cone_slope(there, weights[c], cones[c]) * moved[c])
        for i in range(n):
            acc = qacc[i] + at * step[i]
            low = wp.min(acc - limits[i][0], 0.0)
            high = wp.min(-acc - limits[i][1], 0.0)
            first += step[i] * (limit_weights[i][0] * low - limit_weights[i][1] * high)
            if low < 0.0:
                second += limit_weights[i][0] * step[i] * step[i]
            if high < 0.0:
                second += limit_weights[i][1] * step[i] * step[i]
        return wp.vec2(first, second)

    @wp.func
    def line_search(
        begin: float, quadratic: wp.vec2, count: int, missing: Vectors, moved: Vectors, weights: Vectors,
        cones: Vectors, limits: Pairs, limit_weights: Pairs, qacc: column, step: column,
    ) -> float:  # fmt: skip
        """How much of a step lowers the cost most: where its slope, ``begin`` at first, is almost none."""
        low = float(0.0)
        high = float(1e10)
        at = float(1.0)
        for _ in range(SEARCHES):
            slope = slope_along(at, quadratic, count, missing, moved, weights, cones, limits, limit_weights, qacc, step)
            if wp.abs(slope[0]) <= FLAT * wp.abs(begin):
                break
            if slope[0] < 0.0:
                low = at
            else:
                high = at
            at = at - slope[0] * reciprocal(slope[1])
            if at <= low or at >= high:
                at = 0.5 * (low + wp.min(high, 2.0 * low + 1.0))
        return at

    @wp.func
    def add_curvature(hessian: square, own: wide, curved: wp.mat33) -> square:
        """The lower half of a Hessian with that of one contact."""
        for i in range(n):
            bent = curved * wp.vec3(own[0, i], own[1, i], own[2, i])
            for j in range(i + 1):
                hessian[i, j] += bent[0] * own[0, j] + bent[1] * own[1, j] + bent[2] * own[2, j]
        return hessian

    @wp.func
    def times(matrix: square, motion: column) -> column:
        """A symmetric matrix, by its lower half, times a vector."""
        out = column()
        for i in range(n):
            out[i] += matrix[i, i] * motion[i]
            for j in range(i):
                out[i] += matrix[i, j] * motion[j]
                out[j] += matrix[i, j] * motion[i]
        return out

    @wp.func
    def solve(
        matrix: square, smooth: column, first: column, count: int, rows: wp.array(dtype=wide), wanted: Vectors,
        weights: Vectors, cones: Vectors, limits: Pairs, limit_weights: Pairs, iterations: int, tolerance: float,
        push: Vectors, missing: Vectors, moved: Vectors,
    ) -> tuple[column, column]:  # fmt: skip
        """Accelerations, from a first guess, and all forces on the joints; fills in those of contacts, ``push``."""
        acc = column()
        total = column()
        for i in range(n):
            acc[i] = first[i]
        done = int(0)
        curved = bool(True)  # whether this pass makes the Hessian, too: the second one almost always ends the search
        while True:
            flat = times(matrix, acc) - smooth
            gradient = column()
            hessian = square()
            for i in range(n):
                low = wp.min(acc[i] - limits[i][0], 0.0)
                high = wp.min(-acc[i] - limits[i][1], 0.0)
                gradient[i] = flat[i] + limit_weights[i][0] * low - limit_weights[i][1] * high
                if curved:
                    for j in range(i + 1):
                        hessian[i, j] = matrix[i, j]
                    if low < 0.0:
                        hessian[i, i] += limit_weights[i][0]
                    if high < 0.0:
                        hessian[i, i] += limit_weights[i][1]
            for c in range(count):
                own = rows[c]
                weight = weights[c]
                cone = cones[c]
                there = seen(own, acc) - wanted[c]
                force = cone_force(there, weight, cone)
                for i in range(n):
                    gradient[i] -= wp.dot(wp.vec3(own[0, i], own[1, i], own[2, i]), force)
                missing[c] = there
                push[c] = force
                if curved:
                    bend = cone_slope(there, weight, cone)
                    if bend[0, 0] > 0.0:
                        hessian = add_curvature(hessian, own, bend)
            level = bool(True)
            for i in range(n):
                level = level and gradient[i] * gradient[i] <= tolerance * matrix[i, i]
            if done == iterations or level:
                total = flat - gradient + smooth
                break
            if not curved:
                curved = True
                continue
            step = solved(factor(hessian), -gradient)
            for c in range(count):
                moved[c] = seen(rows[c], step)
            quadratic = wp.vec2(wp.dot(flat, step), wp.dot(step, times(matrix, step)))
            at = line_search(
                wp.dot(gradient, step), quadratic, count, missing, moved, weights, cones, limits, limit_weights, acc,
                step,
            )  # fmt: skip
            acc = acc + at * step
            curved = False
            done += 1
        return acc, total

    @wp.func
    def implicit(matrix: square, slope: column, timestep: float, total: column) -> column:
        """Accelerations over a step in which forces that depend on velocities are those at its end."""
        for i in range(n):
            matrix[i, i] = matrix[i, i] - timestep * slope[i]
        return solved(factor(matrix), total)

    return solve, implicit
