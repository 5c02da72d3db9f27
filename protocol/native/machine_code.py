"""Compile a kernel to an object file, by numba, for this processor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from protocol.native import wrappers
from protocol.numba_import import import_numba

if TYPE_CHECKING:
    from protocol.kernels import Kernel


@dataclass(frozen=True)
class CompiledKernel:
    """A kernel's object file, and what calls it."""

    function: wrappers.Function
    code: bytes
    """Content of the object file."""


def compile_to_object(kernel: Kernel) -> CompiledKernel:
    """Compile a kernel and those that it calls. ValueError if its code is valid in this process only.

    This process must not call kernels later: their modules have compiled functions then that only kernels can call.
    """
    (compiled,) = _compile(kernel).overloads.values()
    if compiled.library.has_dynamic_globals:
        raise ValueError(f"kernel {kernel.function.__qualname__} depends on addresses of this process")
    module = compiled.library._final_module.clone()
    symbol = f"kernel_{kernel.digest}"
    for each in (*module.functions, *module.global_variables):
        if each.name == compiled.fndesc.llvm_func_name:
            each.name, each.visibility = symbol, "hidden"
        elif not each.is_declaration:
            each.linkage = "internal"  # names of helpers are unique in this process only
    names = kernel.function.__code__.co_varnames
    types = compiled.signature.args
    function = wrappers.Function(
        kernel.function.__name__,
        kernel.digest,
        symbol,
        tuple((name, _type(each)) for name, each in zip(names, types, strict=False)),
        None if compiled.signature.return_type.key == "none" else _type(compiled.signature.return_type),
    )
    return CompiledKernel(function, _emit(module, compiled.library.codegen))


@cache
def _compile(kernel: Kernel) -> Any:
    """Return numba's compiled function, without wrappers for Python."""
    for name, called in kernel.called.items():
        kernel.function.__globals__[name] = _compile(called)
    compile_for = import_numba().njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
    dispatcher = compile_for(kernel.function)
    dispatcher.compile(kernel.signature)
    dispatcher.disable_compile()
    return dispatcher


def _type(kind: Any) -> wrappers.Type:
    """Return a type of numba as one of `wrappers`."""
    types = import_numba().types
    if isinstance(kind, types.BaseTuple):
        return wrappers.Tuple(tuple(map(_type, kind)))
    if isinstance(kind, types.Array):
        assert kind.layout == "C"
        return wrappers.Array(str(kind.dtype), kind.ndim, kind.mutable)
    return wrappers.Scalar(str(kind))


def _emit(module: Any, codegen: Any) -> bytes:
    """Drop functions that are inlined everywhere, and return machine code that can be anywhere in memory."""
    from llvmlite import binding  # noqa: PLC0415  LLVM, which no other module of Murmur needs

    machine = binding.Target.from_triple(module.triple).create_target_machine(
        cpu=codegen._get_host_cpu_name(),
        features=codegen._tm_features,
        opt=import_numba().config.OPT,
        reloc="pic",
        codemodel="default",
    )
    passes = binding.create_new_module_pass_manager()
    passes.add_global_dead_code_eliminate_pass()
    builder = binding.create_pass_builder(machine, binding.create_pipeline_tuning_options(speed_level=3))
    passes.run(module, builder)
    code: bytes = machine.emit_object(module)
    return code
