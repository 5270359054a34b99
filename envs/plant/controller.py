"""The controller's contract: what a law sees, what it returns, and the registry of names.

A **law** is any namespace (module or class) with::

    class Params(NamedTuple): …                     # Annotated[float, Quantity(…)] fields: these are tuned
    class State(NamedTuple): …
    def init(params) -> State
    def control(params, state, signals, tables) -> (State, command)      # command: head velocity, mm/s, up positive

``signals`` is a :class:`Sensed`, :class:`Preview` or :class:`Privileged` according to the *information class* under
which the law was registered; a law cannot read what its class does not hold. ``tables`` is a one-dimensional float64
array shared by all machines, empty unless the law brought one. The functions are compiled; a law in plain Python
implements ``reset()`` and ``control(signals)`` instead and runs through the same machine, only slower.
"""

import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import lanes
from .kernels import Kernel, specialise
from .lanes import doubles, load, part, store
from .quantity import InvalidInput, did_you_mean

PERIOD = 1e-3
"""s, control period (Xi2023)."""

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


class Preview(NamedTuple):
    """:class:`Sensed` and the sheet ahead (information class *preview*)."""

    height: float = 0.0
    raw_height: float = 0.0
    frequency: float = 0.0
    valid: bool = False
    set_height: float = 0.0
    head_position: float = 0.0
    head_velocity: float = 0.0
    command: float = 0.0
    mode: float = 0.0
    override: bool = False
    captured: bool = False
    fresh: bool = True
    feed: float = 0.0
    surface_0: float = 0.0  # mm, surface under the nozzle now
    surface_1: float = 0.0  # mm, and in 1 … 5 ms
    surface_2: float = 0.0
    surface_3: float = 0.0
    surface_4: float = 0.0
    surface_5: float = 0.0


class Privileged(NamedTuple):
    """:class:`Preview` and the truth (information class *privileged*)."""

    height: float = 0.0
    raw_height: float = 0.0
    frequency: float = 0.0
    valid: bool = False
    set_height: float = 0.0
    head_position: float = 0.0
    head_velocity: float = 0.0
    command: float = 0.0
    mode: float = 0.0
    override: bool = False
    captured: bool = False
    fresh: bool = True
    feed: float = 0.0
    surface_0: float = 0.0
    surface_1: float = 0.0
    surface_2: float = 0.0
    surface_3: float = 0.0
    surface_4: float = 0.0
    surface_5: float = 0.0
    gap: float = 0.0  # mm, true gap now
    head: float = 0.0  # mm, true position of the nozzle
    velocity: float = 0.0  # mm/s, true velocity of the motor
    acceleration: float = 0.0  # mm/s², true acceleration of the motor


INFORMATION = {"sensor": Sensed, "preview": Preview, "privileged": Privileged}
"""Information classes, least first; each begins with the fields of the one before (the kernel relies on it)."""

SLOTS = ("z",)
"""What a stack can drive: ``z``, head velocity at 1 kHz."""

LAW_PARAMS, LAW_STATE = 24, 40
"""Rows that a law's ``Params`` and ``State`` may take."""


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

    @property
    def signals(self) -> Any:
        """Class of the signals that the law sees."""
        return INFORMATION[self.information]


_stages: dict[str, Any] = {}

# Filled in by `stage_of` for each law.
_init: Any = None
_control: Any = None
_Params: Any = None
_State: Any = None
_Signals: Any = None
_P = _S = _X = _WISH = _SIZE = lanes.U0


def _stage(block_address, at, n, tables_address, tables_size):
    """The law for the lanes 0…n − 1 of the block at ``at``."""
    block = doubles(block_address, _SIZE)
    tables = doubles(tables_address, tables_size)
    for lane in range(n):
        a = at + lane
        params = load(_Params, block, a + _P)
        signals = load(_Signals, block, a + _X)
        if signals.fresh:
            state = _init(params)
        else:
            state = load(_State, block, a + _S)
        state, command = _control(params, state, signals, tables)
        store(block, a + _S, state)
        block[a + _WISH] = command


def stage_of(law: Law, rows: dict[str, np.uint64]) -> int:
    """Address of the law's compiled lane loop; ``rows`` tells where its params, state, signals and wish lie."""
    # Names of stages become file names in the cache: the law's own name and a digest of its text.
    digest = hashlib.sha256(law.source.encode()).hexdigest()[:12]
    name = f"{law.name}.{digest}".replace("-", "_").replace(":", "_")
    if name not in _stages:
        _stages[name] = specialise(
            _stage, name, law.source, _init=law.init, _control=law.control, _Params=law.Params, _State=law.State,
            _Signals=law.signals, _P=rows["params"], _S=rows["state"], _X=rows["signals"], _WISH=rows["wish"],
            _SIZE=lanes.U(2**40),
        )  # fmt: skip
    return _stages[name].address


def stage_address(function: Callable[..., None]) -> int:
    """Address of an environment's stage, compiled and cached with the text of its file as part of the key."""
    name = f"{function.__module__}.{function.__qualname__}"
    if name not in _stages:
        path = inspect.getsourcefile(function)
        text = Path(path).read_text(encoding="utf-8") if path else ""
        _stages[name] = Kernel(function, text)
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
    if information not in INFORMATION:
        raise InvalidInput(f"unknown information class '{information}'; {did_you_mean(information, INFORMATION)}")
    for cls, most in ((space.Params, LAW_PARAMS), (space.State, LAW_STATE)):
        if not lanes.is_part(cls):
            raise InvalidInput(f"controller '{name}': {cls!r} is not a NamedTuple")
        if lanes.rows(cls) > most:
            raise InvalidInput(f"controller '{name}': {cls.__name__} has {lanes.rows(cls)} numbers; at most {most}")
    doc = inspect.getdoc(space) or ""
    return Law(
        name=name, summary=doc.split("\n")[0], information=information, slot=slot, Params=space.Params,
        State=space.State, init=_compiled(space.init), control=_compiled(space.control),
        tables=np.zeros(0) if tables is None else np.ascontiguousarray(tables, np.float64).ravel(),
        source=source_of(space),
    )  # fmt: skip


def source_of(space: Any) -> str:
    """Text of the file that holds a controller; enters the stamp of its compiled code."""
    try:
        path = inspect.getsourcefile(space)
        return Path(path).read_text(encoding="utf-8") if path else ""
    except (OSError, TypeError):
        return ""
