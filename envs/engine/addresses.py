"""Addresses that keep alive what they point to.

A kernel gets plain numbers, and a plain number keeps nothing alive. So an address leaves its owner as an
:class:`Address`, and an array that holds some is a :class:`Words`.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np


class Address(int):
    """Where something lies: a whole number that keeps ``owner`` alive."""

    owner: Any

    def __new__(cls, number: int, owner: Any) -> "Address":
        made = super().__new__(cls, number)
        made.owner = owner
        return made


def address(array: np.ndarray) -> Address:
    """Of an array's first number."""
    return Address(array.ctypes.data, array)


class Words(np.ndarray):
    """uint64 words for a kernel, shape (n,); what the addresses among ``values`` point to lives as long as they do."""

    owners: tuple[Any, ...] = ()

    def __new__(cls, values: Iterable[int]) -> "Words":
        given = tuple(values)
        made = np.array(given, np.uint64).view(cls)
        made.owners = tuple(value.owner for value in given if isinstance(value, Address))
        return made
