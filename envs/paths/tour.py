"""A shorter way through contours: stretches of the order are turned round, short runs go elsewhere.

The first is 2-opt (Croes 1958), the second Or-opt (Or 1976).

What must come first stays first: a stretch turns round only if no contour of it lies within another of it, and a run
moves only past contours that it neither lies within nor holds. Each contour is joined with those nearest to it, as long
as that makes the way shorter; who gets new neighbours is asked again (don't-look bits, Bentley 1992).
"""

from collections import deque
from math import hypot

import numpy as np

from .curve import Indices, Points

NEIGHBOURS = 7
"""Nearest contours that each is joined with."""

LONGEST = 1000
"""Contours in a stretch that turns round, or that a run moves past: longer ones are not worth their time."""

RUNS = ((0, 0), (0, 1), (-1, 0), (0, 2), (-2, 0))
"""Runs that move: their first and last place, from a contour on."""

MANY = 20_000
"""Contours beyond which only single ones move: of 60 000 runs save one hundredth more and take half as long again."""

TRIES, MOST_TRIES = 40, 400_000
"""Contours that are weighed, in all contours' mean and together: a number and not a time, so that every computer finds
this order."""

_LEAST = 1e-6  # mm


def improved(order: Indices, turned: Indices, ends: Points, around: list[list[int]]) -> tuple[Indices, Indices]:
    """The order with less way between contours, from the origin on.

    Args:
        order: contours in an allowed order.
        turned: for each place of it, 1 if its contour is travelled backwards.
        ends: first and last point of each contour, shape (n, 2, 2), mm.
        around: for each contour those that must come after it.
    """
    if len(order) < 3:
        return order, turned
    tour = _Tour(order, turned, ends, around)
    tour.shorten()
    return np.array(tour.order), np.array([tour.turned[c] for c in tour.order])


class _Tour:
    """The order as it is; ``place`` of each contour, and whether each is ``turned``.

    For each place of the order ``begins`` and ``finishes`` have where its contour is entered and left, and ``joints``
    how far it is from there to the next place, mm. Their last entries are those of the place before the first, the
    origin, which has the index −1.
    """

    def __init__(self, order: Indices, turned: Indices, ends: Points, around: list[list[int]]) -> None:
        count = len(order)
        self.order: list[int] = order.tolist()
        self.turned = [0] * count
        self.place = [0] * count
        self.ends: list[list[list[float]]] = ends.tolist()
        self.begins: list[list[float]] = [[0.0, 0.0] for _ in range(count + 1)]
        self.finishes: list[list[float]] = [[0.0, 0.0] for _ in range(count + 1)]
        self.joints = [0.0] * (count + 1)
        self._put(0, list(zip(self.order, turned.tolist(), strict=True)))
        self.around = around
        self.within: list[list[int]] = [[] for _ in around]
        for inner, outers in enumerate(around):
            for outer in outers:
                self.within[outer].append(inner)
        self.near = _neighbours(ends)
        self.runs = RUNS if count <= MANY else RUNS[:1]

    def shorten(self) -> None:
        """Makes what helps, until nothing does."""
        waiting, queued = deque(self.order), [True] * len(self.order)
        left = min(TRIES * len(self.order), MOST_TRIES)
        while waiting and left > 0:
            c = waiting.popleft()
            queued[c] = False
            left -= 1
            while touched := self._better(c):
                for other in touched:
                    if not queued[other]:
                        queued[other] = True
                        waiting.append(other)

    # What may be done

    def _better(self, c: int) -> list[int]:
        """Joins ``c`` with a near contour if that helps; who has new neighbours then."""
        at = self.place[c]
        longest = max(self.joints[at - 1], self.joints[at])
        for other, apart in self.near[c]:
            if apart >= longest:
                break  # to be joined with it would only make the way longer here; what helps there is found there
            there = self.place[other]
            i, j = (at, there) if at < there else (there, at)
            if j - i > LONGEST:
                continue
            # The ends of both meet, or their starts.
            for a, b in ((i + 1, j), (i, j - 1)):
                if a < b and self._turning(a, b) > _LEAST and self._may_turn(a, b):
                    return self._turn(a, b)
            for a, b in self.runs:
                for to in (there - 1, there):
                    if self._moving(at + a, at + b, to) > _LEAST and (found := self._moved(at + a, at + b, to)):
                        return found
        return []

    def _turning(self, a: int, b: int) -> float:
        """mm that are saved if places a … b turn round."""
        after = _way(self.begins[a], self.begins[b + 1]) if b + 1 < len(self.order) else 0.0
        return self.joints[a - 1] + self.joints[b] - _way(self.finishes[a - 1], self.finishes[b]) - after

    def _may_turn(self, a: int, b: int) -> bool:
        return not any(a <= self.place[inner] for c in self.order[a : b + 1] for inner in self.within[c])

    def _turn(self, a: int, b: int) -> list[int]:
        self._put(a, [(c, 1 - self.turned[c]) for c in reversed(self.order[a : b + 1])])
        return self._at(a - 1, a, b, b + 1)

    def _moving(self, a: int, b: int, to: int, back: bool = True) -> float:
        """mm that are saved if places a … b go behind place ``to``, turned round if that is better and ``back``; 0 if
        that is no move."""
        count = len(self.order)
        if a < 0 or b >= count or a - 1 <= to <= b or to < -1:
            return 0.0
        saved = self.joints[a - 1] + self.joints[b] + self.joints[to]
        if b + 1 < count:
            saved -= _way(self.finishes[a - 1], self.begins[b + 1])
        before, first, last = self.finishes[to], self.begins[a], self.finishes[b]
        way = _way(before, first)
        beyond = self.begins[to + 1] if to + 1 < count else None
        if beyond is not None:
            way += _way(last, beyond)
        if back:
            way = min(way, _way(before, last) + (_way(first, beyond) if beyond is not None else 0.0))
        return saved - way

    def _moved(self, a: int, b: int, to: int) -> list[int]:
        """Puts places a … b behind place ``to`` if that helps and is allowed, turned round if that is better."""
        straight = self._moving(a, b, to, back=False)
        turns = self._moving(a, b, to) > straight and (a == b or self._may_turn(a, b))
        if not turns and straight <= _LEAST:
            return []
        run = [(c, self.turned[c]) for c in self.order[a : b + 1]]
        low, high = (b + 1, to) if to > b else (to + 1, a - 1)
        # What goes later may not lie within what it passes, what goes earlier may not hold it.
        if to > b and any(low <= self.place[outer] <= high for c, _ in run for outer in self.around[c]):
            return []
        if to < a and any(low <= self.place[inner] <= high for c, _ in run for inner in self.within[c]):
            return []
        passed = [(c, self.turned[c]) for c in self.order[low : high + 1]]
        if turns:
            run = [(c, 1 - t) for c, t in reversed(run)]
        start = min(a, low)
        self._put(start, [*passed, *run] if to > b else [*run, *passed])
        end = max(b, high)
        return self._at(start - 1, start, start + len(run), end - len(run), end, end + 1)

    def _put(self, start: int, contours: list[tuple[int, int]]) -> None:
        for at, (c, t) in enumerate(contours, start):
            self.order[at], self.place[c], self.turned[c] = c, at, t
            self.begins[at], self.finishes[at] = self.ends[c][t], self.ends[c][1 - t]
        for at in range(start - 1, min(start + len(contours), len(self.order) - 1)):
            self.joints[at] = _way(self.finishes[at], self.begins[at + 1])

    def _at(self, *places: int) -> list[int]:
        return [self.order[at] for at in places if 0 <= at < len(self.order)]


def _way(a: list[float], b: list[float]) -> float:
    return hypot(a[0] - b[0], a[1] - b[1])


def _neighbours(ends: Points) -> list[list[tuple[int, float]]]:
    """For each contour the nearest others with how far apart their nearest ends are, mm."""
    from scipy.spatial import KDTree  # slow, as the readers of files are

    count = len(ends)
    sides = 1 if (ends[:, 0] == ends[:, 1]).all() else 2
    points = ends[:, :sides].reshape(-1, 2)
    apart, near = KDTree(points).query(points, min(sides * (NEIGHBOURS + 1), len(points)))
    apart, near = apart.reshape(count, -1), (near // sides).reshape(count, -1)
    rising = np.argsort(apart, axis=1, kind="stable")
    apart, near = (np.take_along_axis(q, rising, axis=1).tolist() for q in (apart, near))
    out = []
    for i, (far, which) in enumerate(zip(apart, near, strict=True)):
        found: dict[int, float] = {}
        for other, distance in zip(which, far, strict=True):
            if other != i:
                found.setdefault(other, distance)
        out.append(list(found.items()))
    return out
