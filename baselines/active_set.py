"""A quadratic program of a plan of changes, solved exactly by a dual active-set method, in compiled code.

    minimise ½·(x − x₀)ᵀH(x − x₀)   with   |x_i| ≤ most   and   |start + x_0 + … + x_i| ≤ bound_i,    i = 0 … n − 1

H is positive definite, x₀ what would be best without bounds. The method (Goldfarb and Idnani 1983) begins there, takes
one violated bound after another into its set, drops those that pull the wrong way, and keeps every intermediate point
optimal for its set; so it ends at the optimum after finitely many steps, mostly about as many as bounds are active.
``bound_i`` is ``fastest``, or as near to it as ``most`` allows where ``start`` lies beyond it, so a plan always exists.
"""

from kerfgym.envs.engine.lanes import clip, part, stage

TOLERANCE = 1e-9
"""Violation, of ``most`` and ``fastest`` together, that counts as none; :func:`solve` clips what is left."""


def room(n: int) -> int:
    """Numbers that :func:`solve` needs to work with."""
    return 2 * n * n + 5 * n


@part
def bound(i, most, start, fastest):
    """Largest size of the sum up to ``x_i``."""
    return max(fastest, abs(start) - (i + 1.0) * most)


@stage
def factor(m, n, h, jay):
    """The inverse transposed Cholesky factor of H into ``jay`` (n × n each, by rows); H is overwritten."""
    for j in range(n):
        for i in range(j, n):
            total = m[h + i * n + j]
            for k in range(j):
                total -= m[h + i * n + k] * m[h + j * n + k]
            m[h + i * n + j] = total**0.5 if i == j else total / m[h + j * n + j]
    for j in range(n):  # L·y = e_j; J = L⁻ᵀ has y as its row j
        for i in range(n):
            total = 1.0 if i == j else 0.0
            for k in range(j, i):
                total -= m[h + i * n + k] * m[jay + j * n + k]
            m[jay + j * n + i] = total / m[h + i * n + i] if i >= j else 0.0


@stage
def solve(m, n, jay, x, work, most, start, fastest):
    """Turns x₀ at offset ``x`` into the optimum; returns the number of steps.

    Args:
        m: float64 array that everything lies in.
        n: length of the plan.
        jay: offset of H's inverse transposed Cholesky factor (:func:`factor`).
        x: offset of the plan.
        work: offset of :func:`room` numbers.
        most, start, fastest: the bounds, above.
    """
    j, r = work, work + n * n
    d, z, y, active, pull = r + n * n, r + n * n + n, r + n * n + 2 * n, r + n * n + 3 * n, r + n * n + 4 * n
    for i in range(n * n):
        m[j + i] = m[jay + i]
    size, steps, tolerance = 0, 0, TOLERANCE * (most + fastest)
    while steps < 6 * n:
        # The bound that is violated most: kinds 0, 1 of x_i from below and above, 2, 3 of the sum.
        worst, kind, at, total = tolerance, -1, 0, start
        for i in range(n):
            one = m[x + i]
            total += one
            limit = bound(i, most, start, fastest)
            if abs(one) - most > worst:
                worst, at, kind = abs(one) - most, i, 0 if one < 0.0 else 1
            if abs(total) - limit > worst:
                worst, at, kind = abs(total) - limit, i, 2 if total < 0.0 else 3
        if kind < 0:
            break
        sign = 1.0 if kind == 0 or kind == 2 else -1.0
        first = at if kind < 2 else 0
        multiplier, slack, adding = 0.0, -worst, True
        while adding and steps < 6 * n:
            steps += 1
            whole, free = 0.0, 0.0
            for k in range(n):  # d = Jᵀ·n
                total = 0.0
                for i in range(first, at + 1):
                    total += m[j + i * n + k]
                m[d + k] = sign * total
                whole += total * total
                free += total * total if k >= size else 0.0
            for i in range(n):  # z = J₂·d₂
                total = 0.0
                for k in range(size, n):
                    total += m[j + i * n + k] * m[d + k]
                m[z + i] = total
            for i in range(size - 1, -1, -1):  # R·pull = d₁
                total = m[d + i]
                for k in range(i + 1, size):
                    total -= m[r + i * n + k] * m[pull + k]
                m[pull + i] = total / m[r + i * n + i]
            partial, leaves = 1e300, -1
            for k in range(size):
                if m[pull + k] > 0.0 and m[y + k] < partial * m[pull + k]:
                    partial, leaves = m[y + k] / m[pull + k], k
            moves = free > 1e-14 * whole
            full = -slack / free if moves else 1e300
            if leaves < 0 and not moves:  # cannot be: a plan exists
                return steps
            step = min(partial, full)
            if moves:
                for i in range(n):
                    m[x + i] += step * m[z + i]
                slack += step * free
            for k in range(size):
                m[y + k] -= step * m[pull + k]
            multiplier += step
            if moves and full <= partial:
                for k in range(n - 1, size, -1):  # rotates d₂ into its first entry
                    one, two = m[d + k - 1], m[d + k]
                    if two != 0.0:
                        length = (one * one + two * two) ** 0.5
                        c, s = one / length, two / length
                        m[d + k - 1] = length
                        for i in range(n):
                            one, two = m[j + i * n + k - 1], m[j + i * n + k]
                            m[j + i * n + k - 1], m[j + i * n + k] = c * one + s * two, c * two - s * one
                for i in range(size + 1):
                    m[r + i * n + size] = m[d + i]
                m[y + size], m[active + size] = multiplier, 4.0 * at + kind
                size += 1
                adding = False
            else:
                size -= 1
                for k in range(leaves, size):
                    m[y + k], m[active + k] = m[y + k + 1], m[active + k + 1]
                    for i in range(k + 2):
                        m[r + i * n + k] = m[r + i * n + k + 1]
                for k in range(leaves, size):  # what is left below the diagonal is rotated away
                    one, two = m[r + k * n + k], m[r + (k + 1) * n + k]
                    length = (one * one + two * two) ** 0.5
                    c, s = (one / length, two / length) if length > 0.0 else (1.0, 0.0)
                    for i in range(k, size):
                        one, two = m[r + k * n + i], m[r + (k + 1) * n + i]
                        m[r + k * n + i], m[r + (k + 1) * n + i] = c * one + s * two, c * two - s * one
                    for i in range(n):
                        one, two = m[j + i * n + k], m[j + i * n + k + 1]
                        m[j + i * n + k], m[j + i * n + k + 1] = c * one + s * two, c * two - s * one
    total = start
    for i in range(n):  # rounding, and whatever a plan cut short left
        limit = bound(i, most, start, fastest)
        low, high = max(total - most, -limit), min(total + most, limit)
        one = clip(total + m[x + i], low, high)
        m[x + i] = one - total
        total = one
    return steps
