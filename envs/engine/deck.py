"""Decks: the words that a kernel is given, by name, and the owner of all that they point to.

A kernel gets plain numbers, and a plain number keeps nothing alive. So whatever a kernel works on belongs to a deck,
and whoever holds the deck, or a function that runs a kernel on it, holds all of that.
"""

import ctypes
from collections.abc import Mapping
from typing import Any, NoReturn, TypeVar

import numpy as np

_E = TypeVar("_E")


def places(entries: type[_E]) -> _E:
    """Where a kernel finds the entries of a deck: ``deck[D.block]`` with ``D = places(Entries)``."""
    fields: tuple[str, ...] = entries._fields  # type: ignore[attr-defined]
    return entries(*range(len(fields)))


def refuse_copy(thing: Any) -> NoReturn:
    """What is bound to memory that kernels know has this for its ``__reduce__``.

    Raises:
        TypeError: always. The copy's kernels would work on the original's memory.
    """
    raise TypeError(
        f"a {type(thing).__name__} can't be copied or pickled, because kernels know the addresses of its memory; "
        "make another one and give it the same seeds"
    )


class Deck:
    """What a kernel is given: 64-bit words, shape (entries,), each a number or the address of an array or a deck.

    Args:
        entries: a NamedTuple class; its fields name the words in their order.
        values: of entries, as :meth:`__setitem__` takes them; the others are 0.

    Raises:
        TypeError: when it is to be copied or pickled.
    """

    def __init__(self, entries: Any, /, **values: Any) -> None:
        self._index: Mapping[str, int] = {name: i for i, name in enumerate(entries._fields)}
        self._owned: dict[str, Any] = {}
        self.words = np.zeros(len(self._index), np.uint64)
        """The words alone. They keep nothing alive: for those that the deck keeps alive itself."""
        self._address = int(self.words.ctypes.data)
        for name, value in values.items():
            self[name] = value

    def __setitem__(self, name: str, value: "int | np.ndarray | Deck | None") -> None:
        """Writes an entry: a number (a count, a stage's address; None is 0), or an array or another deck, which lives
        as long as the entry points to it.

        Raises:
            KeyError: no such entry.
            ValueError: an array that is not contiguous.
        """
        self.words[self._index[name]] = word(value)
        if isinstance(value, (np.ndarray, Deck)):  # a union is slower
            self._owned[name] = value
        else:
            self._owned.pop(name, None)

    def __getitem__(self, name: str) -> int:
        """An entry as the number that kernels see; a kernel may have changed it."""
        return int(self.words[self._index[name]])

    def owned(self, name: str) -> Any:
        """The array or deck that an entry points to; None if it is a number."""
        return self._owned.get(name)

    def __reduce__(self) -> Any:
        refuse_copy(self)


def word(value: int | np.ndarray | Deck | None) -> int:
    """What a kernel is given for a number, an array or a deck; alive only as long as these are.

    Raises:
        ValueError: an array that is not contiguous.
    """
    if isinstance(value, int):
        return value
    if isinstance(value, Deck):
        return value._address
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise ValueError(f"an array of strides {value.strides} is not contiguous; kernels read numbers in a row")
        return int(value.ctypes.data)
    return int(value or 0)


def pointer(given: np.ndarray | Deck) -> Any:
    """The same as :func:`word` for calls in quick succession: ctypes passes it on as it is. It keeps the array alive,
    or the deck's words, but not what these point to.

    Raises:
        TypeError: an array that is not contiguous or can't be written.
    """
    words: Any = given.words if isinstance(given, Deck) else given
    return ctypes.byref(ctypes.c_char.from_buffer(words))
