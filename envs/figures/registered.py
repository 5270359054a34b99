"""What a metric says about itself, once: tables, searches and the manual read it from here."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..engine.quantity import InvalidInput, check_choice, did_you_mean, in_order

BETTER = ("lower", "higher")
POOLED = ("mean", "rms", "largest", "smallest")

TAKEN = in_order(
    "controller information scenario seed failed runs score ratio typical wins rank tied scale budget trials "
    "tuning_steps tuning_cpu reasons note lost tried collisions exempt_collisions ms ms_noise gain_margin "
    "delay_margin extrapolated beyond iso_roughness iso_taper"
)
"""Names that mean something else in the tables of runs and in summaries."""


@dataclass(frozen=True)
class Shown:
    """How tables show a metric: in ``summary.csv``, in the terminal, in ``summary.md`` and on the report page.

    Attributes:
        label: what they call it; its name unless given.
        form: of its numbers in printed tables.
        column: in ``summary.csv``; its name unless given.
        group: of columns on the page.
        head: heading in that group; the label unless given.
        brief: printed alone, without interval and without a line below that explains it; the manual does.
        titled: whether its unit stands in the printed heading.
        said: what the page says of it; its summary and how it is pooled unless given.
        manual: whether the manual's tables of the shipped suites have it.
        compared: whether the page ranks controllers in it, so that a brief one has its interval there.
        seldom: whether controllers seldom differ in it: it stands last in its group, if it is not 1 for all.
    """

    label: str = ""
    form: str = "{:.3g}"
    column: str = ""
    group: str = "other figures"
    head: str = ""
    brief: bool = False
    titled: bool = True
    said: str = ""
    manual: bool = False
    compared: bool = False
    seldom: bool = False


@dataclass(frozen=True)
class Called:
    """What sentences and figures of the report page call a metric that they know.

    Attributes:
        name: in sentences and on the axes of figures.
        less: the word for less of it, such as ``closer``; with it the page says who is best, on a card of its own.
        exact: in the map of scenarios and above the scores; the name unless given.
        question: which of the columns it answers where there are several suites; its name unless given.
    """

    name: str = ""
    less: str = ""
    exact: str = ""
    question: str = ""


@dataclass(frozen=True)
class Metric:
    """A registered metric.

    Attributes:
        name: in ``runs.csv``, on the command line and wherever a program names it.
        unit: of its values; ``1`` if they have none.
        better: ``lower`` or ``higher``.
        summary: what it is, in a line.
        function: from a recorded run to one number per machine, shape (machines,).
        pooled: how one number is made of those of the seeds: ``mean``, ``rms``, ``largest`` or ``smallest``.
        zero: whether it may be zero or infinite in a good run, so that there is no geometric mean over scenarios.
        always: whether a failed run has it as well, so that it is pooled over all runs.
        shown: how tables show it; None: in ``runs.csv`` only.
        called: what sentences and figures of the page call it; unless given, only tables and the map have it.
    """

    name: str
    unit: str
    better: str
    summary: str
    function: Callable[[Any], np.ndarray]
    pooled: str = "mean"
    zero: bool = False
    always: bool = False
    shown: Shown | None = field(default_factory=Shown)
    called: Called = field(default_factory=Called)

    @property
    def meaning(self) -> tuple[str, str, str, bool, bool]:
        """What followers and jobs must agree on, if both have a metric of this name."""
        return self.unit, self.better, self.pooled, self.zero, self.always

    @property
    def label(self) -> str:
        """What tables call it."""
        return (self.shown.label if self.shown else "") or self.name

    @property
    def title(self) -> str:
        """Heading in printed tables."""
        titled = self.unit != "1" and (self.shown is None or self.shown.titled)
        return f"{self.label}, {self.unit}" if titled else self.label

    @property
    def column(self) -> str:
        """Its name in ``summary.csv``."""
        return (self.shown.column if self.shown else "") or self.name

    @property
    def spoken(self) -> str:
        """What sentences call it."""
        return self.called.name or self.name

    @property
    def compared(self) -> bool:
        """Whether the page ranks controllers in it."""
        return bool(self.called.less or (self.shown and self.shown.compared))

    @property
    def exact(self) -> str:
        """What the map of scenarios calls it; empty if it is not there."""
        return self.called.exact or self.called.name or (self.label if self.shown and not self.shown.brief else "")


EVERY: dict[str, Metric] = {}
"""Metrics of followers and of jobs by name; one that both have is pooled alike in both."""


class Registry(dict[str, Metric]):
    """Metrics by name, in the order in which they were registered."""

    def metric(
        self,
        unit: str,
        better: str = "lower",
        *,
        pooled: str = "mean",
        zero: bool = False,
        always: bool = False,
        shown: Shown | None = Shown(),
        called: Called = Called(),
    ) -> Callable:
        """Registers a function under its name; the first line of its docstring says what it is.

        Arguments are those of :class:`Metric`.

        Raises:
            InvalidInput: an unknown word, no docstring, or a name that means something else already.
        """

        def register(function: Callable[[Any], np.ndarray]) -> Callable[[Any], np.ndarray]:
            name, lines = function.__name__, (function.__doc__ or "").strip().split("\n")
            for key, word, known in (("better", better, BETTER), ("pooled", pooled, POOLED)):
                if word not in known:
                    raise InvalidInput(f"metric '{name}': {key} = '{word}'; {did_you_mean(word, known)}")
            if not lines[0]:
                raise InvalidInput(f"metric '{name}': its docstring is missing, whose first line the tables show")
            made = Metric(name, unit, better, lines[0], function, pooled, zero, always, shown, called)
            if made.compared and better != "lower":
                raise InvalidInput(f"metric '{name}': the page ranks what is better lower; this is better {better}")
            other = made if name in self else EVERY.get(name, made)
            columns = {each.column for each in self.values() if each.name != name}
            if {name, made.column} & {*TAKEN, *columns} or other.meaning != made.meaning:
                raise InvalidInput(f"metric '{name}': that name means something else already; give it another")
            self[name] = EVERY[name] = made
            return function

        return register

    def named(self, name: str) -> Metric:
        """A metric by name; raises :class:`InvalidInput` with the nearest name."""
        check_choice(name, self, "metric")
        return self[name]
