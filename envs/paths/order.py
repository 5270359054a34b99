"""In which order contours are cut: what lies within before what is around it, and else the short way.

What has been cut loose may tip or shift: a hole must be cut while its part still hangs in the sheet. Of the contours
that may come next the nearest is taken, and then the order is improved (:mod:`.tour`).
"""

from math import hypot

import numpy as np

from .curve import Curve, Indices, Points
from .nesting import nested
from .tour import improved

_KNOWN = 16
"""Nearest places that are looked up for all places together, before the first step: mostly one of them is free."""

_NEAR = 24
"""Places that are looked at next; four times as many as long as all of them are done or must wait."""

_THIN = 0.8
"""Share of contours left at which the places of those that are cut are taken out of the tree."""

_ALIKE = 1e-9
"""mm, within which two places are as far away as each other until it is looked at closely."""


def ordered(contours: list[Curve], shorten: bool = True) -> list[Curve]:
    """Each contour after all that it contains, on a short way from the origin; open ones from the better end.

    Args:
        contours: closed or open.
        shorten: improve the order in which each is the nearest to the one before.
    """
    if not contours:
        return []
    around = nested([c.points for c in contours], [c.closed for c in contours]).around
    ends = np.array([[c.points[0], c.points[-1]] for c in contours])
    order, turned = nearest(ends, around)
    if shorten:
        order, turned = improved(order, turned, ends, around)
    return [contours[i].reversed() if t else contours[i] for i, t in zip(order.tolist(), turned.tolist(), strict=True)]


def nearest(ends: Points, around: list[list[int]]) -> tuple[Indices, Indices]:
    """Always the nearest of those that may come next, from the origin on; of two as near the first.

    Args:
        ends: first and last point of each contour, shape (n, 2, 2), mm.
        around: for each the contours that must come after it.

    Returns:
        the contours in order, and for each whether it is travelled backwards, 0 or 1.
    """
    waits_for = np.zeros(len(ends), np.int64)
    for outer in around:
        waits_for[outer] += 1
    search = _Search(ends, waits_for.tolist())
    order: list[int] = []
    turned: list[int] = []
    end = search.next(-1)
    while True:
        order.append(end // 2)
        turned.append(end % 2)
        search.take(end // 2, around[end // 2])
        if len(order) == len(ends):
            return np.array(order), np.array(turned)
        end = search.next(search.place_of[end ^ 1])


class _Search:
    """The places where contours end, to be asked for the nearest with a free contour.

    Ends are numbered: ``2 i`` and ``2 i + 1`` are those of contour i. In one place there may be thousands of them.
    """

    def __init__(self, ends: Points, waits_for: list[int]) -> None:
        self.gone, self.waits_for, self.count = [False] * len(ends), waits_for, len(ends)
        self.places, place_of = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
        self.place_of: list[int] = place_of.ravel().tolist()
        self.ends: list[list[int]] = [[] for _ in self.places]
        for end in range(2 * len(ends) - 1, -1, -1):  # the first come last, where they are taken from
            self.ends[self.place_of[end]].append(end)
        self._plant()
        apart, near = self.tree.query(self.places, range(1, min(_KNOWN, len(self.places)) + 1))
        self.known = list(zip(near.tolist(), apart.tolist(), strict=True))

    def _plant(self) -> None:
        """The tree of all places with contours that are not cut."""
        from scipy.spatial import KDTree  # slow, as the readers of files are

        gone = np.repeat(self.gone, 2)
        self.left: Indices = np.unique(np.array(self.place_of)[~gone])
        self.tree, self.planted = KDTree(self.places[self.left]), self.count

    def take(self, contour: int, outers: list[int]) -> None:
        """Cuts a contour, for which the ``outers`` have waited."""
        self.gone[contour] = True
        self.count -= 1
        for outer in outers:
            self.waits_for[outer] -= 1

    def next(self, here: int) -> int:
        """The free end nearest to a place, or to the origin (−1)."""
        if here >= 0:
            near, apart = self.known[here]
            found, far = self._nearest(near, apart)
            if found and far < apart[-1] - _ALIKE:  # or beyond those that are known there may be another as near
                return self._first(found, here)
        return self._first(self._farther(here), here)

    def _nearest(self, near: list[int], apart: list[float]) -> tuple[list[int], float]:
        """Of places by their distance the free ends that are as near as the nearest, and its distance."""
        found: list[int] = []
        far = np.inf
        for place, distance in zip(near, apart, strict=True):
            if distance > far + _ALIKE:
                break
            if (end := self._free(place)) >= 0:
                found.append(end)
                far = min(far, distance)
        return found, far

    def _free(self, place: int) -> int:
        """The first end in a place whose contour is neither cut nor waits, or −1."""
        some = self.ends[place]
        while some and self.gone[some[-1] // 2]:
            some.pop()
        return next((e for e in reversed(some) if not self.gone[e // 2] and not self.waits_for[e // 2]), -1)

    def _farther(self, here: int) -> list[int]:
        if self.count < _THIN * self.planted:
            self._plant()
        many, at = _NEAR, self.places[here] if here >= 0 else np.zeros(2)
        while True:
            many = min(many, len(self.left))
            apart, which = self.tree.query(at, range(1, many + 1))
            found, _ = self._nearest(self.left[which].tolist(), apart.tolist())
            if found:
                return found
            many *= 4

    def _first(self, some: list[int], here: int) -> int:
        """Of ends that are as near as each other the nearest, then the first."""
        if len(some) == 1:
            return some[0]
        x, y = self.places[here].tolist() if here >= 0 else (0.0, 0.0)
        places = self.places[[self.place_of[end] for end in some]].tolist()
        return min(zip(some, places, strict=True), key=lambda each: (hypot(each[1][0] - x, each[1][1] - y), each[0]))[0]
