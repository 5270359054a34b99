"""Progress bars, on standard error, for whatever takes longer than a moment."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

T = TypeVar("T")
Told = Callable[[int, int, str], None]


class Bars:
    """Bars one below the other; each appears when its work begins."""

    def __init__(self, quiet: bool = False) -> None:
        bar = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[count]}"))
        times = (TimeElapsedColumn(), TimeRemainingColumn())
        self._progress = Progress(*bar, *times, console=Console(stderr=True), disable=quiet)

    def __enter__(self) -> "Bars":
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def each(self, title: str, items: Iterable[T], total: int) -> Iterator[T]:
        """The items as they come; without any there is no bar."""
        if not total:
            return
        task = self._progress.add_task(title, total=total, count=f"0/{total}")
        for done, item in enumerate(items, start=1):
            yield item
            self._progress.update(task, completed=done, count=f"{done}/{total}")

    @contextlib.contextmanager
    def busy(self, title: str) -> Iterator[None]:
        """A bar that moves to and fro, for work whose length is not known."""
        task = self._progress.add_task(title, total=None, count="")
        yield
        self._progress.update(task, total=1, completed=1)

    @contextlib.contextmanager
    def counted(self, what: str) -> Iterator[Told]:
        """A bar; gives the function that is told how many are done, of how many, and which was the last."""
        task = self._progress.add_task(what, total=None, count="")

        def told(done: int, total: int, last: str) -> None:
            count, words = f"{done}/{total}", f"{what} · {last}"
            self._progress.update(task, completed=done, total=total, count=count, description=words)

        yield told


@contextlib.contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """A line in the terminal that tells what goes on; gives the function that changes it."""
    with Console(stderr=True).status("") as line:
        yield line.update


@contextlib.contextmanager
def progress(what: str) -> Iterator[Told]:
    """A bar of its own; gives the function that is told how many are done, of how many, and which was the last."""
    with Bars() as bars, bars.counted(what) as told:
        yield told
