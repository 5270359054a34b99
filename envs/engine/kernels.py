"""Kernels: compiled functions, kept on disk as object files, so that a program starts without the compiler.

A kernel is a function of addresses and counts (unsigned 64-bit integers) that returns nothing. Its object file lies
beside its module's byte code. The file's name tells the processor and a hash of all sources that the kernel can
contain; when one of them changes, the kernel is compiled anew (:mod:`compiler`, which imports Numba).
"""

import contextlib
import ctypes
import functools
import hashlib
import inspect
import json
import os
import pathlib
import platform
import tempfile
import types as python_types
from collections.abc import Callable, Iterable
from importlib.metadata import version
from typing import Any

import numpy as np

from .deck import Deck, pointer, refuse_copy, word
from .lanes import W

FOLDERS = ("engine", "plant")
"""Folders side by side whose sources any kernel may contain. They are read here, not imported."""


def _stamp() -> str:
    digest = hashlib.sha256(str(W).encode())
    envs = pathlib.Path(__file__).parent.parent
    for path in sorted(path for folder in FOLDERS for path in (envs / folder).glob("*.py")):
        digest.update(f"{path.parent.name}/{path.name}".encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


STAMP = _stamp()
"""Hash of all these sources."""


def is_stamped(module: str) -> bool:
    """Whether :data:`STAMP` changes with the source of this module."""
    envs = __package__.rpartition(".")[0]
    return module.startswith(tuple(f"{envs}.{folder}." for folder in FOLDERS))


class Kernel:
    """A function of unsigned 64-bit integers, compiled at its first use and kept on disk.

    Args:
        function: calls parts and instructions of :mod:`lanes` only.
        extra: text of whatever else it contains: a controller, an environment's observation.
    """

    def __init__(self, function: Callable[..., None], extra: str = "") -> None:
        self.function, self.extra = function, extra
        self.__doc__ = function.__doc__
        self._together: tuple[Kernel, ...] = (self,)

    def together_with(self, other: "Kernel") -> "Kernel":
        """Shares an object file with ``other``, for kernels that contain the same parts; returns itself."""
        together = (*other._together, self)
        for kernel in together:
            kernel._together = together
        return self

    @functools.cached_property
    def address(self) -> int:
        """Of the machine code, which stays for as long as the program runs."""
        return _addresses(self._together)[self]

    @functools.cached_property
    def _call(self) -> Any:
        return ctypes.CFUNCTYPE(None, *[ctypes.c_uint64] * self.function.__code__.co_argcount)(self.address)

    @functools.cached_property
    def _short_call(self) -> Any:
        return ctypes.PYFUNCTYPE(None)(self.address)  # its argument is a pointer already; nothing is converted

    def __call__(self, *given: int | np.ndarray | Deck) -> None:
        """Runs it without holding Python's lock, so that other threads go on; arrays and decks are given by their
        addresses."""
        self._call(*map(word, given))

    def bound(self, given: np.ndarray | Deck) -> Callable[[], None]:
        """The kernel with its only argument given, as a function that keeps the argument alive.

        For many short calls: it holds Python's lock. It can't be copied or pickled.

        Raises:
            TypeError: a plain number, which keeps nothing alive; a kernel of several arguments; an array that is not
                contiguous or can't be written.
        """
        if (count := self.function.__code__.co_argcount) != 1:
            raise TypeError(f"{symbol(self.function)} has {count} arguments; only a kernel of one can be bound")
        if not isinstance(given, np.ndarray | Deck):
            raise TypeError(f"{given!r} keeps nothing alive; a kernel is bound to a deck or an array")
        made = Bound(self._short_call, pointer(given))
        made.given = given
        return made


class Bound(functools.partial[None]):
    """A kernel and what it works on, see :meth:`Kernel.bound`."""

    given: np.ndarray | Deck

    def __reduce__(self) -> Any:
        refuse_copy(self)


def symbol(function: Callable[..., None]) -> str:
    """Name of a kernel in its object file."""
    return f"kerfgym.{function.__qualname__}"


def _addresses(kernels: tuple[Kernel, ...]) -> dict[Kernel, int]:
    """Addresses of kernels that share an object file, from the disk or the compiler."""
    file, names = _file(kernels), [symbol(kernel.function) for kernel in kernels]
    kept = _kept(file)
    if kept is None:
        from . import compiler

        kept = compiler.compiled({symbol(kernel.function): kernel.function for kernel in kernels})
        _keep(file, *kept)
    return dict(zip(kernels, _load(kept[0], names, kept[1]), strict=True))


def _file(kernels: tuple[Kernel, ...]) -> pathlib.Path:
    first = kernels[0].function
    name = f"{first.__module__.split('.')[-1]}.{first.__qualname__}"
    source = hashlib.sha256((STAMP + "".join(kernel.extra for kernel in kernels)).encode()).hexdigest()
    return cache_folder(inspect.getsourcefile(first) or __file__) / f"{name}-{_machine()}-{source[:16]}.o"


def filled(template: Callable[..., Any], name: str, **values: Any) -> Callable[..., Any]:
    """``template`` with other globals, under a name of its own."""
    assert isinstance(template, python_types.FunctionType)
    function = python_types.FunctionType(
        template.__code__, {**template.__globals__, **values}, template.__name__, template.__defaults__
    )
    function.__module__ = template.__module__
    function.__qualname__ = f"{template.__name__}.{name}"
    return function


def specialise(template: Callable[..., None], name: str, extra: str = "", **values: Any) -> Kernel:
    """:func:`filled` as a kernel."""
    return Kernel(filled(template, name, **values), extra)


# ------------------------------------------------------------------------------------------------ on disk


@functools.cache
def _machine() -> str:
    """What else machine code depends on: the processor and the compiler."""
    from llvmlite import binding as llvm

    about = (
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
        platform.python_version(),
        version("llvmlite"),
        version("numba"),
    )
    return hashlib.sha256("\0".join(about).encode()).hexdigest()[:8]


@functools.cache
def cache_folder(source: str) -> pathlib.Path:
    """``$KERFGYM_CACHE_DIR``; else ``__pycache__`` beside the source, or the user's cache if that cannot be written."""
    if wanted := os.environ.get("KERFGYM_CACHE_DIR"):
        with contextlib.suppress(OSError):
            pathlib.Path(wanted).mkdir(parents=True, exist_ok=True)
            return pathlib.Path(wanted)
    beside = pathlib.Path(source).resolve().parent / "__pycache__"
    with contextlib.suppress(OSError):
        beside.mkdir(exist_ok=True)
        if os.access(beside, os.W_OK):
            return beside
    with contextlib.suppress(OSError, RuntimeError):  # nobody's home
        caches = pathlib.Path(os.environ.get("XDG_CACHE_HOME") or pathlib.Path.home() / ".cache")
        own = caches / "kerfgym" / hashlib.sha256(str(beside).encode()).hexdigest()[:16]
        own.mkdir(parents=True, exist_ok=True)
        return own
    return pathlib.Path(tempfile.mkdtemp(prefix="kerfgym-"))  # compiled for this process only


def _kept(file: pathlib.Path) -> tuple[bytes, bool] | None:
    """Machine code, and whether it needs Numba's run-time library; None if there is no sound file."""
    try:
        head, _, code = file.read_bytes().partition(b"\n")
        entry = json.loads(head)
        return (code, entry["runtime"]) if entry["sha256"] == hashlib.sha256(code).hexdigest() else None
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _keep(file: pathlib.Path, code: bytes, runtime: bool) -> None:
    """Writes a kernel's file whole or not at all (the disk may be full), and removes those of earlier sources."""
    head = json.dumps({"runtime": runtime, "sha256": hashlib.sha256(code).hexdigest()}).encode()
    part = None
    try:
        handle, part = tempfile.mkstemp(dir=file.parent, prefix=file.stem, suffix=".part")
        with os.fdopen(handle, "wb") as out:
            out.write(head + b"\n" + code)
        os.replace(part, file)
        for old in file.parent.glob(f"{file.name[: -len('0123456789abcdef.o')]}*.o"):
            if old != file:
                old.unlink(missing_ok=True)
    except OSError:
        if part:
            pathlib.Path(part).unlink(missing_ok=True)


# ------------------------------------------------------------------------------------------------ in memory

_engines: list[Any] = []  # own the machine code


def _load(code: bytes, symbols: Iterable[str], runtime: bool) -> list[int]:
    from llvmlite import binding as llvm

    if runtime:
        from numba.core.registry import cpu_target
        from numba.core.runtime import rtsys

        rtsys.initialize(cpu_target.target_context)  # makes the symbols of Numba's run-time library known
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(codemodel="jitdefault")
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    _engines.append(engine)
    return [engine.get_function_address(s) for s in symbols]
