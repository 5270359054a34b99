"""From the parts to machine code, by Numba (Lam et al. 2015); imported only when a kernel is not in the cache yet.

Numba compiles each function as something that Python may call: wrapped, optimised, linked, loaded. Parts only ever run
inside a kernel. Here they are lowered once and no more; then a kernel is linked with all parts it calls, optimised and
turned into an object file, once. What to do when Numba changes stands in ``docs/engine.md``.
"""

import inspect
import types as python_types
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

from llvmlite import binding as llvm
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils, codegen, errors
from numba.core import ir as numba_ir
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.imputils import lower_builtin
from numba.core.registry import cpu_target
from numba.core.typed_passes import NativeLowering
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_getattr, signature
from numba.extending import intrinsic
from numba.np.arrayobj import populate_array

from . import lanes

PACKAGE = __name__.split(".")[0]


class Object(NamedTuple):
    """Compiled kernels."""

    code: bytes  # an object file
    runtime: bool  # whether it needs Numba's own run-time library (it allocates, say)


# -------------------------------------------------------------------------------------- instructions of `lanes`

# Written as instructions rather than as functions, because Numba would compile a function for every class.


def _numba_type(cls: Any) -> Any:
    inner = [
        _numba_type(k) if lanes.is_part(k) else (types.boolean if k is bool else types.float64)
        for k in lanes.kinds(cls)
    ]
    return types.BaseTuple.from_types(inner, cls)


def _cell(builder, data, at, row):
    return builder.gep(data, [builder.add(at, ir.Constant(ir.IntType(64), row * lanes.W))])


def _read(context, builder, cls, data, at, row):
    """Instructions that read ``cls`` from ``row`` on; returns its value and the next free row."""
    values = []
    for kind in lanes.kinds(cls):
        if lanes.is_part(kind):
            value, row = _read(context, builder, kind, data, at, row)
        else:
            value, row = builder.load(_cell(builder, data, at, row)), row + 1
            if kind is bool:
                value = builder.fcmp_unordered("!=", value, ir.Constant(ir.DoubleType(), 0.0))
        values.append(value)
    return context.make_tuple(builder, _numba_type(cls), values), row


def _write(context, builder, cls, data, at, row, value):
    """Instructions that write ``value`` from ``row`` on; returns the next free row."""
    parts = cgutils.unpack_tuple(builder, value)
    for kind, x in zip(lanes.kinds(cls), parts, strict=True):
        if lanes.is_part(kind):
            row = _write(context, builder, kind, data, at, row, x)
        else:
            if kind is bool:
                x = builder.uitofp(x, ir.DoubleType())
            builder.store(x, _cell(builder, data, at, row))
            row += 1
    return row


@intrinsic
def _load(typingctx, cls, block, at):
    kind = cls.instance_class

    def codegen(context, builder, signature, args):
        data = context.make_array(block)(context, builder, args[1]).data
        return _read(context, builder, kind, data, args[2], 0)[0]

    return _numba_type(kind)(cls, block, types.uint64), codegen


@intrinsic
def _store(typingctx, block, at, value):
    kind = getattr(value, "instance_class", None)
    whole = kind and _numba_type(kind)
    if value != whole:  # not Numba's error, of which it would tell no more than that there was one
        raise TypeError(f"{value} is not {whole or 'a NamedTuple'}")

    def codegen(context, builder, signature, args):
        data = context.make_array(block)(context, builder, args[0]).data
        _write(context, builder, kind, data, args[1], 0, args[2])
        return context.get_dummy_value()

    return types.none(block, types.uint64, whole), codegen


def _array(context, builder, kind, data, count):
    """Instructions that take ``count`` numbers at the pointer ``data`` for an array."""
    array, width = (
        context.make_array(kind)(context, builder),
        context.get_constant(types.intp, kind.dtype.bitwidth // 8),
    )
    populate_array(array, data=data, shape=[count], strides=[width], itemsize=width, meminfo=None)
    return array._getvalue()


def _view(number: Any, word: ir.Type) -> Any:
    """The instruction that takes an address for an array."""
    kind = types.Array(number, 1, "C")

    @intrinsic
    def view(typingctx, address, size):
        def codegen(context, builder, signature, args):
            data = builder.inttoptr(args[0], word.as_pointer())
            return _array(context, builder, kind, data, builder.bitcast(args[1], ir.IntType(64)))

        return kind(types.uint64, types.uint64), codegen

    return view


@intrinsic
def _call(typingctx, function, block, at, n, tables, size):
    word = ir.IntType(64)

    def codegen(context, builder, signature, args):
        kind = ir.FunctionType(ir.VoidType(), [word] * 5)
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.none(*([types.uint64] * 6)), codegen


@intrinsic(prefer_literal=True)
def _scratch(typingctx, size):
    if not isinstance(size, types.IntegerLiteral):
        raise errors.TypingError("the size of a scratch array is known when compiling")
    count, kind = size.literal_value, types.Array(types.float64, 1, "C")

    def codegen(context, builder, signature, args):
        with builder.goto_entry_block():
            room = builder.alloca(ir.ArrayType(ir.DoubleType(), count))  # not zeroed
            room.align = 64  # a vector must not straddle two cache lines
        data = builder.bitcast(room, ir.DoubleType().as_pointer())
        return _array(context, builder, kind, data, context.get_constant(types.intp, count))

    return kind(size), codegen


@intrinsic
def _take(typingctx, array, i):
    def codegen(context, builder, signature, args):
        data = context.make_array(array)(context, builder, args[0]).data
        return builder.atomic_rmw("add", builder.gep(data, [args[1]]), ir.Constant(ir.IntType(64), 1), "seq_cst")

    return types.uint64(array, types.uint64), codegen


@intrinsic
def _fma(typingctx, a, b, c):
    def codegen(context, builder, signature, args):
        numbers = [context.cast(builder, x, kind, types.float64) for x, kind in zip(args, signature.args, strict=True)]
        return builder.fma(*numbers)

    return types.float64(a, b, c), codegen


@intrinsic
def _choose(typingctx, test, a, b):
    def codegen(context, builder, signature, args):
        numbers = [context.cast(builder, args[i], signature.args[i], types.float64) for i in (1, 2)]
        return builder.select(args[0], *numbers)

    return types.float64(types.boolean, a, b), codegen


def _same_bits(given: Any, wanted: Any, word: ir.Type) -> Any:
    """The instruction that takes the bits of one kind of number for another's."""

    @intrinsic
    def same_bits(typingctx, x):
        def codegen(context, builder, signature, args):
            return builder.bitcast(args[0], word)

        return wanted(given), codegen

    return same_bits


@infer_getattr
class _Replacing(AttributeTemplate):
    """``part._replace(field=value, …)``: the fields that are not named stay."""

    key = types.BaseNamedTuple

    def resolve__replace(self, whole):
        class Replace(AbstractTemplate):
            key = "kerfgym._replace"

            def generic(self, args, kws):
                if args or not kws.keys() <= set(whole.fields):
                    raise errors.TypingError(f"_replace takes fields of {whole.instance_class.__name__} by name")
                fields = [
                    inspect.Parameter(f, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=None) for f in whole.fields
                ]
                given = (kws.get(f, types.Omitted(None)) for f in whole.fields)
                return signature(whole, *given, recvr=whole).replace(pysig=inspect.Signature(fields))

        return types.BoundFunction(Replace, whole)


@lower_builtin("kerfgym._replace", types.BaseNamedTuple, types.VarArg(types.Any))
def _replace(context, builder, signature, args):
    values = cgutils.unpack_tuple(builder, args[0])
    for i, (given, wanted) in enumerate(zip(signature.args[1:], signature.return_type, strict=True)):
        if not isinstance(given, types.Omitted):
            values[i] = context.cast(builder, args[i + 1], given, wanted)
    return context.make_tuple(builder, signature.return_type, values)


_INSTRUCTIONS = {
    lanes.load: _load,
    lanes.store: _store,
    lanes.call: _call,
    lanes.fma: _fma,
    lanes.choose: _choose,
    lanes.take: _take,
    lanes.scratch: _scratch,
    lanes.as_bits: _same_bits(types.float64, types.uint64, ir.IntType(64)),
    lanes.as_number: _same_bits(types.uint64, types.float64, ir.DoubleType()),
    lanes.as_bits32: _same_bits(types.float32, types.uint32, ir.IntType(32)),
    lanes.as_number32: _same_bits(types.uint32, types.float32, ir.FloatType()),
    lanes.words: _view(types.uint64, ir.IntType(64)),
    lanes.doubles: _view(types.float64, ir.DoubleType()),
    lanes.singles: _view(types.float32, ir.FloatType()),
    lanes.flags: _view(types.uint8, ir.IntType(8)),
}


# ----------------------------------------------------------------------------------- functions as Numba wants them

_dispatchers: dict[Any, Any] = {}
_views: dict[Any, Any] = {}


class _View(python_types.ModuleType):
    """A module of ours as compiled code sees it: its parts are compiled functions."""

    def __init__(self, module: python_types.ModuleType) -> None:
        super().__init__(module.__name__)
        self.__dict__["_module"] = module

    def __getattr__(self, name: str) -> Any:
        value = _translated(getattr(self._module, name))
        self.__dict__[name] = value
        return value


def _translated(value: Any) -> Any:
    """What a name means in compiled code."""
    if isinstance(value, Dispatcher):  # a user's own, which stays callable from Python as it is
        value = lanes.part(value.py_func)
    if isinstance(value, python_types.FunctionType):
        value = cast(Any, _INSTRUCTIONS).get(value, value)
        if value not in lanes.PARTS:
            return value
        return (
            _dispatchers[value] if value in _dispatchers else _dispatcher(value, forceinline=value not in lanes.STAGES)
        )
    if isinstance(value, python_types.ModuleType) and _holds_parts(value):
        if value not in _views:
            _views[value] = _View(value)
        return _views[value]
    return value


def _holds_parts(module: python_types.ModuleType) -> bool:
    if module.__name__.split(".")[0] == PACKAGE:
        return True
    functions = (v for v in vars(module).values() if isinstance(v, Dispatcher | python_types.FunctionType))
    return any(isinstance(f, Dispatcher) or f in lanes.PARTS for f in functions)


def _dispatcher(function: Callable[..., Any], forceinline: bool) -> Any:
    """The function as compiled code calls it; nothing is compiled yet."""
    copy = _copied(function)
    ours = function.__module__.split(".")[0] == PACKAGE  # allocates nothing
    wrappers = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiles = njit(error_model="numpy", pipeline_class=_Pipeline, _nrt=not ours, forceinline=forceinline, **wrappers)
    _dispatchers[function] = compiles(copy)
    _translate_globals(copy)  # only now, because an attribute may have the name of the function itself
    return _dispatchers[function]


def for_python(function: Callable[..., Any]) -> Any:
    """The function compiled so that Python can call it with whatever arguments, to try parts out."""
    copy = _copied(function)
    _translate_globals(copy)
    return njit(error_model="numpy")(copy)


def _copied(function: Callable[..., Any]) -> Any:
    """The function with globals of its own."""
    copy = python_types.FunctionType(
        function.__code__, dict(function.__globals__), function.__name__, function.__defaults__, function.__closure__
    )
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return copy


def _translate_globals(function: Any) -> None:
    space = function.__globals__
    for name in {name for code in _codes(function.__code__) for name in code.co_names if name in space}:
        space[name] = _translated(space[name])


def _codes(code: python_types.CodeType) -> list[python_types.CodeType]:
    return [code] + [c for k in code.co_consts if isinstance(k, python_types.CodeType) for c in _codes(k)]


# ----------------------------------------------------------------------------------------------- Numba's pipeline


class _Library(codegen.CPUCodeLibrary):
    """Code of one part: kept as it was lowered, to be optimised within the kernels that call it."""

    stages: tuple[str, ...] = ()  # its functions that are not to be inlined

    def __init__(self, codegen_, name):
        codegen.CodeLibrary.__init__(self, codegen_, name)
        self._linking_libraries, self._texts = [], []

    def add_ir_module(self, ir_module):
        # The compiler prefers 256-bit vectors where 512-bit ones slow the clock down a little; lane loops gain more.
        for function in ir_module.functions:
            set.add(function.attributes, '"prefer-vector-width"="512"')
        self._texts.append(str(ir_module))

    def finalize(self):
        self._finalized = True

    def everything(self, seen: dict) -> dict:
        """This library and all that it needs, each once."""
        if self not in seen:
            seen[self] = None
            for library in self._linking_libraries:
                library.everything(seen) if isinstance(library, _Library) else seen.setdefault(library)
        return seen

    def own_module(self) -> Any:
        """Its own code, which may be linked more than once."""
        module = llvm.parse_assembly("")
        for text in self._texts:
            module.link_in(llvm.parse_assembly(text))
        for f in module.functions:
            if not f.is_declaration:
                f.linkage = "linkonce_odr"
        return module

    def _get_module_for_linking(self):
        """For code that is not a kernel: together with all that it needs."""
        module = self.own_module()
        for library in self.everything({}):
            if library is not self:
                _link(module, library)
        return module


def _link(module: Any, library: codegen.CPUCodeLibrary) -> None:
    """Adds a library's own code to ``module``, without what it needs."""
    if isinstance(library, _Library):
        module.link_in(library.own_module())
    else:
        module.link_in(library._get_module_for_linking(), preserve=True)


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):
    """Lowers into a :class:`_Library`, and makes nothing that Python could call."""

    _name = "kerfgym_lowering"

    def run_pass(self, state):
        for block in state.func_ir.blocks.values():
            for raised in block.find_insts((numba_ir.Raise, numba_ir.StaticRaise, numba_ir.DynamicRaise)):
                raise errors.UnsupportedError("a compiled law runs inside the machine, so it cannot raise", raised.loc)
        state.library = _Library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        if not state.flags.forceinline:
            state.library.stages = (state["cr"].fndesc.mangled_name,)
        key: Any = [].append  # any built-in function; calls find the code by it
        lowered = state["cr"]
        state["cr"] = lowered._replace(cfunc=key)
        state.targetctx.insert_user_function(key, lowered.fndesc, [state.library])
        return True


class _Pipeline(CompilerBase):
    """Numba's own passes; only what comes out at their end is another."""

    def define_pipelines(self):
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_Lowering, NativeLowering)
        passes.passes = [p for p in passes.passes if p[0] is not NativeLowering]
        passes.finalize()
        return [passes]


# --------------------------------------------------------------------------------------------------------- kernels


def compiled(functions: Mapping[str, Callable[..., None]]) -> Object:
    """Machine code of kernels that belong together: functions of unsigned 64-bit integers that return nothing, by the
    names that they get in the object file."""
    whole = _optimised(functions)
    needs = {f.name for f in whole._final_module.functions if f.is_declaration}
    if "numba_gil_release" in needs:
        raise errors.UnsupportedError("compiled code runs without Python, so it cannot print or call Python back")
    runtime = any(name.startswith(("NRT_", "numba_")) for name in needs)
    return Object(whole.codegen._tm.emit_object(whole._final_module), runtime)


def assembly(functions: Mapping[str, Callable[..., None]]) -> str:
    """The same as assembly, to look at what the loops have become."""
    whole = _optimised(functions)
    return whole.codegen._tm.emit_assembly(whole._final_module)


def _optimised(functions: Mapping[str, Callable[..., None]]) -> codegen.CPUCodeLibrary:
    """The kernels linked with all that they call, and optimised."""
    context = cpu_target.target_context
    whole = codegen.CPUCodeLibrary(context.codegen(), "kerfgym")
    module = whole.create_ir_module("entries")
    needed: dict[Any, None] = {}
    for name, function in functions.items():
        needed = _entry(name, function, module, context).everything(needed)
    whole.add_ir_module(module)
    stages: list[str] = []
    # Numba's own last: the linker takes of its run-time library only what is called already.
    for library in sorted(needed, key=lambda library: not isinstance(library, _Library)):
        _link(whole._final_module, library)
        stages += library.stages if isinstance(library, _Library) else []
    for name in stages:
        whole._final_module.get_function(name).add_function_attribute("noinline")
    for f in whole._final_module.functions:
        if not f.is_declaration and f.name not in functions:
            f.linkage = "internal"
    whole._optimize_final_module()
    whole._final_module.verify()
    return whole


def _entry(name: str, function: Callable[..., None], module: ir.Module, context: Any) -> _Library:
    """Puts the C function that calls a kernel into ``module``; returns the kernel's code."""
    dispatcher = _dispatcher(function, forceinline=True)
    arguments = (types.uint64,) * function.__code__.co_argcount
    dispatcher.compile(types.void(*arguments))
    result = dispatcher.overloads[arguments]
    kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64)] * len(arguments))
    entry = ir.Function(module, kind, name)
    builder = ir.IRBuilder(entry.append_basic_block())
    inner = context.declare_function(module, result.fndesc)
    context.call_conv.call_function(builder, inner, types.none, arguments, list(entry.args))
    builder.ret_void()
    return result.library
