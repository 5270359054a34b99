"""Processor in the loop: an exported follower on an emulated Cortex-M4F and M7.

The same vectors are played to the code that a compiler makes for the processor. The emulator (QEMU) counts
instructions, not cycles: it knows neither caches nor how long a memory takes. So the share of the period at a clock is
an estimate, of one instruction a cycle.
"""

import re
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from ...envs.engine.quantity import InvalidInput
from . import c_files

COMPILER, EMULATOR, SIZES = "arm-none-eabi-gcc", "qemu-system-arm", "arm-none-eabi-size"

SHIFT, SYSTICK = 7, 25e6
"""2^SHIFT ns pass for an instruction of the emulated processor, whose timer counts at so many Hz."""

CLOCK = 168e6
"""Hz, at which the share of the period is estimated."""

PERIOD = 1e-3
"""s"""


@dataclass(frozen=True)
class Processor:
    """One that is emulated: its name, the emulator's board, and what the compiler is told of it."""

    name: str
    board: str
    flags: tuple[str, ...]


PROCESSORS = (
    Processor("Cortex-M4F", "mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16")),
    Processor("Cortex-M7", "mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16")),
)


@dataclass(frozen=True)
class Ran:
    """What came of it.

    Attributes:
        processor: its name.
        calls: periods.
        difference: mm/s, the farthest that a command was from the kernel's.
        median, worst: instructions of a call, and of that which took most.
        first: of that after a start which took most; laws that solve for their gains do it then.
        stack: bytes that a call needs, looked at in every hundredth.
        ram: bytes of a ``Controller``.
        flash: bytes of code and constants of the controller, without libraries.
    """

    processor: str
    calls: int
    difference: float
    median: float
    worst: float
    first: float
    stack: int
    ram: int
    flash: int

    @property
    def share(self) -> float:
        """Of the period that the worst call but the first takes, at one instruction a cycle."""
        return self.worst / (CLOCK * PERIOD)

    @property
    def words(self) -> str:
        """In a line."""
        return (
            f"{self.processor}: {self.calls} periods, largest difference {self.difference:.3g} mm/s; "
            f"{self.median:.0f} instructions a call, {self.worst:.0f} at worst, about {self.share:.1%} of the period "
            f"at {CLOCK / 1e6:.0f} MHz (estimate, one instruction a cycle); "
            f"{self.first:.0f} in the first call; stack {self.stack}, RAM {self.ram}, "
            f"flash {self.flash} bytes"
        )


def missing() -> list[str]:
    """Programs that are needed and are not there."""
    return [name for name in (COMPILER, EMULATOR, SIZES) if shutil.which(name) is None]


def ran(folder: Path, processor: Processor) -> Ran:
    """Compiles an exported folder for a processor and plays its vectors there.

    Raises:
        InvalidInput: it does not compile, or does not come to its end.
    """
    flags = [*processor.flags, "-mthumb", "-mfloat-abi=hard", "-ffunction-sections", "-fdata-sections"]
    strict = [flag for flag in c_files.FLAGS if flag not in ("-Werror",)]
    with tempfile.TemporaryDirectory() as place:
        code, program = Path(place) / "controller.o", Path(place) / "program.elf"
        _done([COMPILER, *flags, *c_files.FLAGS, "-c", "controller.c", "-o", str(code)], folder)
        link = ["-Wl,--gc-sections", "-nostartfiles", "--specs=rdimon.specs", f"-T{folder.resolve() / 'processor.ld'}"]
        crt = _done([COMPILER, *flags, "-print-file-name=rdimon-crt0.o"], folder).strip()
        _done([COMPILER, *flags, *strict, "-w", "processor.c", str(code), crt, *link, "-o", str(program),
               "-lc", "-lm", "-lrdimon"], folder)  # fmt: skip
        sizes = _done([SIZES, str(code)], folder).splitlines()[1].split()
        emulate = [EMULATOR, "-M", processor.board, "-nographic", "-monitor", "none", "-serial", "null",
                   "-semihosting-config", "enable=on,target=native", "-icount", f"shift={SHIFT}",
                   "-kernel", str(program)]  # fmt: skip
        text = _done(emulate, folder)
    found = re.search(
        r"calls (\d+) difference (\S+) ticks_median (\d+) ticks_worst (\d+) ticks_first (\d+) stack (\d+) ram (\d+)",
        text,
    )
    if found is None:
        raise InvalidInput(f"'{folder}' on {processor.name}: the emulator gave no result: {text[-300:]}")
    per = SYSTICK * 2**SHIFT * 1e-9
    calls, difference, median, worst, first, stack, ram = (float(word) for word in found.groups())
    flash = int(sizes[0]) + int(sizes[1])
    return Ran(
        processor.name, int(calls), difference, median / per, worst / per, first / per, int(stack), int(ram), flash
    )


def _done(command: list[str], folder: Path) -> str:
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240)
    except subprocess.TimeoutExpired:
        raise InvalidInput(f"'{folder}': {command[0]} did not come to its end in four minutes") from None
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[-300:])
        raise InvalidInput(f"'{folder}': {command[0]}: {first}")
    return done.stdout + done.stderr


def told(folder: Path) -> list[str]:
    """What both processors say; why not, where they cannot be emulated."""
    if lacking := missing():
        return [f"on a processor: not tried, {', '.join(lacking)} not installed"]
    return [ran(folder, processor).words for processor in PROCESSORS]
