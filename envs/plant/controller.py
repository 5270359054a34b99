"""The controller's contract: what a law sees, what it returns, and how it is compiled.

A **law** is any namespace (module or class) with::

    class Params(NamedTuple): …                     # Annotated[float, Quantity(…)] fields: these are tuned
    class State(NamedTuple): …
    def init(params) -> State
    def control(params, state, signals, tables) -> (State, command)

A law fills a *slot* of the machine, which decides what it sees, what it commands, and how often:

| slot      | rate                       | signals                   | command                                      |
|-----------|----------------------------|---------------------------|----------------------------------------------|
| `z`       | 1 ms                       | :class:`Sensed`           | head velocity, mm/s, up positive             |
| `xy`      | servo period, 4 ms in Wu   | :class:`AxesSensed`       | :class:`Velocities` of the axes, mm/s        |
| `process` | 8 ms                       | :class:`ProcessSensed`    | :class:`Process`: feed, dither, focus, …     |

In slots ``z`` and ``process`` the *information class* under which the law was registered may give it more, such as
:data:`Preview` or :data:`Privileged`; a law cannot read what its class does not hold. ``tables`` is a one-dimensional
float64 array shared by all machines, empty unless the law brought one. A law of the slot ``z`` that solves or learns
something, and so needs more than a few numbers, declares ``MEMORY = n``: its ``control`` gets a fifth argument, ``n``
numbers of the machine's own, which outlast an episode (``signals.fresh`` says when one begins). The functions are
compiled; a law in plain Python implements ``reset()`` and ``control(signals)`` instead and runs through the same
machine, only slower.

A law that says what it sees, and whose command is a sum of signals with weights, lets a policy choose the weights. It
declares, beside ``MEMORY``::

    FEATURES: tuple[str, ...]       # what it sees: the first numbers of its memory, from −10 to 10
    WEIGHTS: tuple[Weight, ...]     # what an action moves
    ACTION: int                     # where in its memory actions lie, one number from −1 to 1 for each weight
    def weigh(params, state, signals, memory) -> command

``control`` sets the actions to 0 and returns what ``weigh`` does; an environment puts others there and weighs again.
For learning by gradients it also declares what of it depends on the head, see :mod:`derivatives`::

    Loop: NamedTuple                # what goes on from period to period, commands on their way among it
    READS: int                      # what `loop` reads lies among so many first numbers of its memory
    def loop(params, state, felt, memory) -> (Loop, command)
"""

import hashlib
import inspect
import re
import types
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..engine import lanes
from ..engine.kernels import Kernel, is_stamped, specialise
from ..engine.lanes import doubles, extended, load, part, store
from ..engine.quantity import InvalidInput, did_you_mean

PERIOD = 1e-3
"""s, control period (Xi2023)."""

LARGEST_MEMORY = 1 << 20
"""Numbers that a law may keep for each machine."""

AHEAD = 5
"""ms of sheet that a preview law knows."""


class Sensed(NamedTuple):
    """What the real machine measures (information class *sensor*), once per control period."""

    height: float = 0.0  # mm, filtered frequency looked up in the table
    raw_height: float = 0.0  # mm, newest frequency looked up in the table
    frequency: float = 0.0  # Hz, newest count; 0 at contact
    valid: bool = False  # the newest count is a reading (the nozzle does not touch)
    set_height: float = 0.0  # mm
    head_position: float = 0.0  # mm, encoder at the gate's centre
    head_velocity: float = 0.0  # mm/s, from the encoder over the last period
    command: float = 0.0  # mm/s, what the supervisor sent to the drive last
    mode: float = 0.0  # of the supervisor, see supervisor.MODES
    override: bool = False  # the supervisor's command, not the law's, went to the drive
    captured: bool = False  # the approach is over
    fresh: bool = True  # first period of an episode
    feed: float = 0.0  # mm/s along the path
    place: float = 0.0  # mm along the path, of the lap where the path is travelled again and again
    lap: float = 0.0  # laps that are over


class SheetAhead(NamedTuple):
    """What a preview law knows beside :class:`Sensed`."""

    surface_0: float = 0.0  # mm, surface under the nozzle now
    surface_1: float = 0.0  # mm, and in 1 … 5 ms
    surface_2: float = 0.0
    surface_3: float = 0.0
    surface_4: float = 0.0
    surface_5: float = 0.0


class Truth(NamedTuple):
    """What no sensor tells about the head."""

    gap: float = 0.0  # mm, true gap now
    head: float = 0.0  # mm, true position of the nozzle
    velocity: float = 0.0  # mm/s, true velocity of the motor
    acceleration: float = 0.0  # mm/s², true acceleration of the motor


Preview: Any = extended("Preview", Sensed, SheetAhead)
"""Information class *preview*."""

Privileged: Any = extended("Privileged", Preview, Truth)
"""Information class *privileged*."""


class AxesSensed(NamedTuple):
    """What the position loops know at a servo instant."""

    error_x: float = 0.0  # mm, issued before minus moved since, from the encoder (Wu's E_i)
    error_y: float = 0.0
    position_x: float = 0.0  # mm, encoder
    position_y: float = 0.0
    velocity_x: float = 0.0  # mm/s, of the increment that is issued now
    velocity_y: float = 0.0
    acceleration_x: float = 0.0  # mm/s², its change since the last instant
    acceleration_y: float = 0.0
    period: float = 4e-3  # s, servo period
    feed: float = 0.0  # mm/s along the path
    fresh: bool = True  # first instant of an episode


class Velocities(NamedTuple):
    """Command of the slot ``xy``, mm/s."""

    x: float = 0.0
    y: float = 0.0


class ProcessSensed(NamedTuple):
    """What the process control knows every 8 ms (information class *sensor*)."""

    planned: float = 0.0  # mm/s, the feed that the job was planned with, here
    planned_50: float = 0.0  # mm/s, in 50, 100 and 200 ms of the plan
    planned_100: float = 0.0
    planned_200: float = 0.0
    speed: float = 0.0  # mm/s, of the axes' drives
    override: float = 1.0  # feed override in force
    lag: float = 0.0  # mm behind the commanded point, along the path
    contour_error: float = 0.0  # mm beside the path, left positive
    height: float = 0.0  # mm, measured
    set_height: float = 0.0  # mm
    phase: float = 0.0  # of the job, see paths.job
    beam: bool = False
    progress: float = 0.0  # share of the job's time that is over
    thickness: float = 1.0  # mm
    nominal_power: float = 0.0  # W, of the material's recipe
    standoff: float = 1.0  # mm, of the material's recipe
    feed: float = 0.0  # mm/s, that the job's cuts were planned with
    tangent_x: float = 1.0  # direction of the path
    tangent_y: float = 0.0
    fresh: bool = True  # first decision of an episode


class CutTruth(NamedTuple):
    """The cut as it turns out, which no sensor tells."""

    gap: float = 0.0  # mm, true
    margin: float = 0.0  # melt margin, 1: just cuts through
    dross: float = 0.0  # mm
    roughness: float = 0.0  # mm, Rz


ProcessPrivileged: Any = extended("ProcessPrivileged", ProcessSensed, CutTruth)
"""Information class *privileged*."""


class Process(NamedTuple):
    """Command of the slot ``process``."""

    override: float = 1.0  # of the planned feed
    power: float = 1.0  # of the nominal power
    frequency: float = 0.0  # Hz, of the dither
    x: float = 0.0  # mm, amplitudes of the dither
    y: float = 0.0
    z: float = 0.0
    focus: float = 0.0  # mm, offset of the focus, up positive
    standoff: float = 0.0  # mm, added to the nominal standoff


INFORMATION = {"sensor": Sensed, "preview": Preview, "privileged": Privileged}
"""Information classes of the slot ``z``, least first; each begins with the fields of the one before (the kernel relies
on it)."""


class Slot(NamedTuple):
    """What a law in a slot gets and gives."""

    information: dict[str, Any]  # class of the signals by information class
    command: Any  # float, or a NamedTuple
    params: int  # rows that a law's Params may take
    state: int  # and its State


SLOTS = {
    "z": Slot(INFORMATION, float, 24, 32),
    "xy": Slot({"sensor": AxesSensed}, Velocities, 16, 24),
    "process": Slot({"sensor": ProcessSensed, "privileged": ProcessPrivileged}, Process, 24, 24),
}
"""What a stack can drive."""


class Weight(NamedTuple):
    """What an action of a law with :class:`Weighing` moves."""

    name: str
    span: float  # that an action of 1 adds to what the law itself takes
    unit: str = "1"


@dataclass(frozen=True)
class Weighing:
    """What a policy sees of a law, and the weights that it may choose; see the head of this module."""

    features: tuple[str, ...]
    weights: tuple[Weight, ...]
    action: int
    weigh: Callable[..., Any]
    loop: Callable[..., Any] | None = None
    Loop: Any = None
    reads: int = 0


@dataclass(frozen=True)
class Law:
    """A registered control law.

    ``name`` is module-qualified for laws outside the package, so two of them never share compiled code.
    """

    name: str
    summary: str
    information: str
    slot: str
    Params: Any
    State: Any
    init: Callable[..., Any]
    control: Callable[..., Any]
    tables: np.ndarray = field(default_factory=lambda: np.zeros(0), compare=False)
    source: str = ""
    memory: int = 0  # numbers of its own that each machine keeps for it
    weighing: Weighing | None = None

    @property
    def signals(self) -> Any:
        """Class of the signals that the law sees."""
        return SLOTS[self.slot].information[self.information]


_stages: dict[str, Any] = {}

# Filled in by `stage_of` for each law.
_BYTES = lanes.U(8)
_init: Any = None
_control: Any = None
_Params: Any = None
_State: Any = None
_Signals: Any = None
_TIMED = _REMEMBERS = False
_P = _S = _X = _WISH = _DUE = _MEMORY = _STRIDE = lanes.U0
_ANY = lanes.U(2**40)


def _stage(block_address, at, n, tables_address, tables_size):
    """The law for the lanes 0…n − 1 of the block at ``at``.

    In a slot with a rate of its own only for those whose turn it is. The memories of laws that have one lie behind the
    tables.
    """
    block, tables = doubles(block_address, _ANY), doubles(tables_address, tables_size)
    for lane in range(n):
        a = at + lane
        if not _TIMED or block[a + _DUE] > 0.5:
            params, signals = load(_Params, block, a + _P), load(_Signals, block, a + _X)
            if signals.fresh:
                state = _init(params)
            else:
                state = load(_State, block, a + _S)
            if _REMEMBERS:
                machine = (at // _STRIDE) * lanes.UW + at % _STRIDE + lane
                memory = doubles(tables_address + _BYTES * (tables_size + machine * _MEMORY), _MEMORY)
                state, command = _control(params, state, signals, tables, memory)
            else:
                state, command = _control(params, state, signals, tables)
            store(block, a + _S, state)
            if _TIMED:
                store(block, a + _WISH, command)
            else:
                block[a + _WISH] = command


def stage_of(law: Law, rows: dict[str, np.uint64]) -> int:
    """Address of the law's compiled lane loop.

    Args:
        law: what is compiled.
        rows: where its ``params``, ``state``, ``signals`` and ``wish`` lie; outside the slot ``z`` also ``due``,
            whether it is the lane's turn, in the slot ``z`` the ``stride`` from block to block.
    """
    # Names of stages become file names in the cache: the law's own name and a digest of its text.
    digest = hashlib.sha256(law.source.encode()).hexdigest()[:12]
    name = f"{law.name}.{digest}".replace("-", "_").replace(":", "_")
    if name not in _stages:
        contract = {"_Params": law.Params, "_State": law.State, "_Signals": law.signals}
        places = {"_P": "params", "_S": "state", "_X": "signals", "_WISH": "wish", "_DUE": "due", "_STRIDE": "stride"}
        filled = {own: rows.get(place, lanes.U0) for own, place in places.items()}
        kind = {"_TIMED": "due" in rows, "_REMEMBERS": law.memory > 0, "_MEMORY": lanes.U(law.memory)}
        functions = {"_init": law.init, "_control": law.control}
        _stages[name] = specialise(_stage, name, law.source, **functions, **contract, **filled, **kind)
    try:
        return _stages[name].address
    except Exception as error:  # the compiler's are of many kinds
        raise InvalidInput(f"controller '{law.name}' cannot be compiled: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """The line of the compiler's message that tells what is wrong, and where."""
    lines = [line for line in str(error).splitlines() if line and not line.startswith("Failed in ")]
    places = re.findall(r'File "(.*)", line (\d+)', str(error))
    where = [f" ({file}, line {line})" for file, line in places if Path(file).resolve() != Path(__file__).resolve()]
    return "".join([lines[0] if lines else repr(error), *where[:1]])


def stage_address(function: Callable[..., None], *more: str) -> int:
    """Address of an environment's stage, compiled and cached with the text of its file as part of the key, and of
    ``more`` files that parts of it are in."""
    name = f"{function.__module__}.{function.__qualname__}"
    if name not in _stages:
        paths = [inspect.getsourcefile(function), *more]
        _stages[name] = Kernel(function, "".join(Path(path).read_text(encoding="utf-8") for path in paths if path))
    return _stages[name].address


def _compiled(function: Callable[..., Any]) -> Any:
    return part(getattr(function, "py_func", function))  # a user may have compiled it already


def make_law(space: Any, name: str, information: str = "sensor", slot: str = "z", tables: Any = None) -> Law:
    """A :class:`Law` from a namespace with ``Params``, ``State``, ``init`` and ``control``.

    Raises:
        InvalidInput: something of the contract is missing or too large.
    """
    missing = [word for word in ("Params", "State", "init", "control") if not hasattr(space, word)]
    if missing:
        raise InvalidInput(f"controller '{name}' has no {', '.join(missing)}; a law needs Params, State, init, control")
    if slot not in SLOTS:
        raise InvalidInput(f"controller '{name}': no slot '{slot}' in this machine; {did_you_mean(slot, SLOTS)}")
    contract = SLOTS[slot]
    if information not in contract.information:
        raise InvalidInput(
            f"unknown information class '{information}'; {did_you_mean(information, contract.information)}"
        )
    for cls, most in ((space.Params, contract.params), (space.State, contract.state)):
        if not lanes.is_part(cls):
            raise InvalidInput(f"controller '{name}': {cls!r} is not a NamedTuple")
        if lanes.rows(cls) > most:
            raise InvalidInput(f"controller '{name}': {cls.__name__} has {lanes.rows(cls)} numbers; at most {most}")
    memory = int(getattr(space, "MEMORY", 0))
    if memory and slot != "z":
        raise InvalidInput(f"controller '{name}': MEMORY is for laws of the slot z, not {slot}")
    if not 0 <= memory <= LARGEST_MEMORY:
        raise InvalidInput(f"controller '{name}': MEMORY = {memory}; allowed: 0 to {LARGEST_MEMORY}")
    functions = {"init": _compiled(space.init), "control": _compiled(space.control)}
    weighing = _weighing(space, name, memory)
    told = [*functions.values(), *([weighing.weigh] if weighing else [])]
    return Law(
        name,
        (inspect.getdoc(space) or "").split("\n")[0],
        information,
        slot,
        space.Params,
        space.State,
        **functions,
        tables=np.zeros(0) if tables is None else np.ascontiguousarray(tables, np.float64).ravel(),
        source=source_of(space) + "".join(_told(f, frozenset(), set()) for f in told),
        memory=memory,
        weighing=weighing,
    )


def _weighing(space: Any, name: str, memory: int) -> Weighing | None:
    """What a policy may weigh of a law.

    Raises:
        InvalidInput: something of it is missing, or lies outside of the law's memory.
    """
    parts = ("FEATURES", "WEIGHTS", "ACTION", "weigh")
    missing = [word for word in parts if not hasattr(space, word)]
    if len(missing) == len(parts):
        return None
    if missing:
        raise InvalidInput(f"controller '{name}' has no {', '.join(missing)}; weights need {', '.join(parts)}")
    features, weights, action = tuple(space.FEATURES), tuple(space.WEIGHTS), int(space.ACTION)
    if not len(features) <= action <= memory - len(weights):
        raise InvalidInput(
            f"controller '{name}': {len(features)} features and {len(weights)} actions from {action} on do not lie one "
            f"behind the other in a MEMORY of {memory}"
        )
    loop = getattr(space, "loop", None)
    if loop is None:
        return Weighing(features, weights, action, _compiled(space.weigh))
    return Weighing(features, weights, action, _compiled(space.weigh), _compiled(loop), space.Loop, int(space.READS))


def source_of(space: Any) -> str:
    """Text of the file that holds a controller; enters the stamp of its compiled code."""
    try:
        path = inspect.getsourcefile(space)
        return Path(path).read_text(encoding="utf-8") if path else ""
    except (OSError, TypeError):
        return ""


def _told(value: Any, names: frozenset[str], seen: set[Any]) -> str:
    """Text that changes with whatever compiled code takes over from ``value``, be it from another file.

    Args:
        value: what a name in the code stands for.
        names: all names in that code; those of a module's attributes are among them.
        seen: what has been told.
    """
    function = getattr(value, "py_func", value)
    if isinstance(function, types.FunctionType):
        known = function is value and function not in lanes.COMPILED  # to the compiler: NumPy's, say
        if known or function in seen or is_stamped(function.__module__):  # the stamp tells these
            return ""
        seen.add(function)
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        space = {**function.__globals__, **{name: cell.cell_contents for name, cell in cells}}
        text, names = _code_told(function.__code__)
        return f"{text}{function.__defaults__}{_all_told(space, names, seen)}"
    if isinstance(value, types.ModuleType) and (value, names) not in seen:
        seen.add((value, names))
        return _all_told(vars(value), names, seen)
    if lanes.is_part(value):
        return f"{value._fields}{vars(value).get('__annotations__')}{value._field_defaults}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if isinstance(value, tuple):
        return "".join(f"{_told(each, names, seen)}," for each in value)
    return repr(value) if isinstance(value, int | float | complex | str | np.generic) else ""


def _all_told(space: dict[str, Any], names: frozenset[str], seen: set[Any]) -> str:
    return "".join(f"{name} {_told(space[name], names, seen)}\n" for name in sorted(names & space.keys()))


def _code_told(code: types.CodeType) -> tuple[str, frozenset[str]]:
    """What a function does, and all names in it."""
    text, names = code.co_code.hex(), frozenset(code.co_names + code.co_freevars)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            inner, more = _code_told(constant)
            text, names = text + inner, names | more
        else:
            text += str(sorted(map(repr, constant))) if isinstance(constant, frozenset) else repr(constant)
    return f"{text}{code.co_names}", names
