"""The discrete algebraic Riccati equation, by iterating it, in compiled code.

For one input (Anderson and Moore 1990), ``x⁺ = A·x + b·u`` and the cost ``Σ xᵀQx + r·u²``::

    P ← Q + AᵀPA − kᵀk·s,   s = r + bᵀPb,   k = bᵀPA/s,       u = −k·x

started from P = Q; it converges for whatever can be stabilised, as fast as the square of the closed loop's slowest
mode dies. A Kalman filter of one measurement ``y = cᵀx`` is the same for Aᵀ and c, P then being the variance of the
prediction and ``P·c/s`` the gain on the innovation. Matrices lie by rows in an array ``m``, each from an offset on.
"""

from kerfgym.envs.engine.lanes import stage

MOST = 20000
"""Iterations at most."""

SETTLED, ROUNDING = 1e-12, 1e-15
"""It ends when an iteration changes no gain by more than this share of itself, and of the largest."""


@stage
def solve(m, n, a, b, q, r, p, k, work):
    """Writes P (n × n) and the gains k (n); returns s.

    Args:
        m: float64 array that everything lies in.
        n: number of states.
        a, b, q: offsets of A (n × n), b (n) and the diagonal of Q (n).
        r: cost of the input, above 0.
        p, k, work: offsets of P (n × n), k (n) and room for n × n numbers.
    """
    for i in range(n):
        m[k + i] = 0.0
        for j in range(n):
            m[p + i * n + j] = m[q + i] if i == j else 0.0
    s = r
    for _ in range(MOST):
        for i in range(n):
            for j in range(n):
                total = 0.0
                for via in range(n):
                    total += m[p + i * n + via] * m[a + via * n + j]
                m[work + i * n + j] = total
        s = r
        for i in range(n):
            for j in range(n):
                s += m[b + i] * m[p + i * n + j] * m[b + j]
        change, size = 0.0, 0.0
        for j in range(n):
            total = 0.0
            for i in range(n):
                total += m[b + i] * m[work + i * n + j]
            total /= s
            change = max(change, abs(total - m[k + j]) - SETTLED * abs(total))
            size = max(size, abs(total))
            m[k + j] = total
        for i in range(n):
            for j in range(n):
                total = m[q + i] if i == j else 0.0
                for via in range(n):
                    total += m[a + via * n + i] * m[work + via * n + j]
                m[p + i * n + j] = total - m[k + i] * m[k + j] * s
        if change <= ROUNDING * size and size > 0.0:
            break
    return s
