"""The ledger: what tuning, training or a benchmark cost, in simulated steps and CPU-seconds, and on which seeds.

Every command that learns something from the machine records it in ``run.json`` in the same form, so that two results
can be compared at equal steps.
"""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ...envs import scenarios
from ...envs.engine.quantity import InvalidInput, check_choice


@dataclass
class Ledger:
    """Costs that add up.

    Attributes:
        steps: control periods simulated, over all machines.
        cpu_seconds: of the process.
        seeds: of the scenarios, by split.
    """

    steps: int = 0
    cpu_seconds: float = 0.0
    seeds: dict[str, set[int]] = field(default_factory=dict)

    def use(self, seeds: Iterable[int]) -> None:
        """Notes seeds of scenarios; each belongs to one split.

        Raises:
            InvalidInput: a seed that belongs to none.
        """
        for seed in seeds:
            self.seeds.setdefault(split_of(int(seed)), set()).add(int(seed))

    def add(self, steps: int, cpu_seconds: float) -> None:
        """Adds a cost."""
        self.steps += int(steps)
        self.cpu_seconds += float(cpu_seconds)

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Adds the CPU time of the block."""
        start = time.process_time()
        try:
            yield
        finally:
            self.cpu_seconds += time.process_time() - start

    def __add__(self, other: "Ledger") -> "Ledger":
        """Both together."""
        total = Ledger(self.steps + other.steps, self.cpu_seconds + other.cpu_seconds)
        for split in {**self.seeds, **other.seeds}:
            total.seeds[split] = self.seeds.get(split, set()) | other.seeds.get(split, set())
        return total

    def entry(self) -> dict[str, Any]:
        """As ``run.json`` holds it: seeds as ranges, such as ``0-31,40``."""
        body: dict[str, Any] = {"simulated_steps": self.steps, "cpu_seconds": round(self.cpu_seconds, 2)}
        if self.seeds:
            body["seeds"] = {split: ranges(self.seeds[split]) for split in scenarios.SPLITS if split in self.seeds}
        return body

    def check(self, allowed: str) -> None:
        """Makes sure that nothing but one split was used.

        Raises:
            InvalidInput: seeds of another split.
        """
        check_choice(allowed, scenarios.SPLITS, "split")
        for split, used in self.seeds.items():
            if split != allowed and used:
                raise InvalidInput(f"seeds {ranges(used)} are of split '{split}'; allowed: '{allowed}'")


def split_of(seed: int) -> str:
    """The split that a scenario seed belongs to.

    Raises:
        InvalidInput: none.
    """
    for split, seeds in scenarios.SPLITS.items():
        if seed in seeds:
            return split
    raise InvalidInput(f"seed {seed} belongs to no split")


def ranges(numbers: Iterable[int]) -> str:
    """Whole numbers as ranges: ``0-31,40``."""
    parts: list[list[int]] = []
    for number in sorted(set(numbers)):
        if parts and number == parts[-1][1] + 1:
            parts[-1][1] = number
        else:
            parts.append([number, number])
    return ",".join(str(a) if a == b else f"{a}-{b}" for a, b in parts)
