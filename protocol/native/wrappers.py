"""C source of the functions through which Python calls compiled kernels.

A function checks and converts the arguments, calls the kernel in numba's calling convention, and returns the result
as a Python object. In this convention, arrays and tuples are passed as their members (`numba.core.callconv`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

KINDS = {"bool": "b", "int": "i", "uint": "u", "float": "f"}
"""numpy's kinds of element types."""


@dataclass(frozen=True)
class Scalar:
    """A number or truth value, of numpy's type `dtype`."""

    dtype: str

    @property
    def kind(self) -> str:
        """Its dtype without the number of bits."""
        return self.dtype.rstrip("0123456789")

    @property
    def c_type(self) -> str:
        """Its type in C."""
        if self.kind == "float":
            return {"float32": "float", "float64": "double"}[self.dtype]
        return "uint8_t" if self.kind == "bool" else f"{self.dtype}_t"


@dataclass(frozen=True)
class Array:
    """A contiguous array; `writes`: whether it must be writable."""

    dtype: str
    dimensions: int
    writes: bool


@dataclass(frozen=True)
class Tuple:
    """A tuple of fixed length."""

    items: tuple[Type, ...]


Type = Scalar | Array | Tuple


@dataclass(frozen=True)
class Function:
    """A compiled kernel."""

    name: str
    digest: str
    symbol: str
    """Its name in the object file."""
    parameters: tuple[tuple[str, Type], ...]
    """Names and types."""
    result: Type | None


def source(functions: Sequence[Function], module: str) -> str:
    """Return the source of an extension module whose members are the kernels, named by their digests."""
    methods = "".join(
        f"    {{{json.dumps(each.name)}, (PyCFunction)(void (*)(void))call_{number}, METH_FASTCALL, NULL}},\n"
        for number, each in enumerate(functions)
    )
    digests = "".join(f"    {json.dumps(each.digest)},\n" for each in functions)
    return "\n".join(
        [
            '#include "runtime.c"\n',
            *(_wrapper(number, each) for number, each in enumerate(functions)),
            f"static PyMethodDef methods[] = {{\n{methods}    {{NULL}}\n}};",
            f"static const char *digests[] = {{\n{digests}    NULL\n}};",
            f'static struct PyModuleDef definition = {{PyModuleDef_HEAD_INIT, "{module}", NULL, -1, NULL}};',
            f"PyMODINIT_FUNC PyInit_{module}(void) {{ return make_module(&definition, methods, digests); }}\n",
        ]
    )


def _wrapper(number: int, function: Function) -> str:
    """Return the C function ``call_NUMBER`` that calls a kernel."""
    name = json.dumps(function.name)
    result = _c_type(function.result)
    shares = _has_array(function.result)
    leaves = [
        leaf for place, (_, kind) in enumerate(function.parameters) for leaf in _leaves(kind, f"a{place}")
    ]
    types = "".join(f", {kind}" for leaf, member in leaves for kind, _ in _members(leaf, member))
    values = "".join(f", {value}" for leaf, member in leaves for _, value in _members(leaf, member))
    lines = [
        f"typedef {result} result_{number};",
        f"extern int32_t {function.symbol}(result_{number} *, exception_t **{types});",
        f"static PyObject *call_{number}(PyObject *self, PyObject *const *given, Py_ssize_t count)",
        "{",
        *(f"    {_variable(leaf)} {member}{_START[type(leaf)]};" for leaf, member in leaves),
        f"    result_{number} result;",
        "    exception_t *exception = NULL;",
        "    PyObject *returned = NULL;",
        f"    if (!has_count({name}, count, {len(function.parameters)}))",
        "        return NULL;",
    ]
    for place, (parameter, kind) in enumerate(function.parameters):
        lines += _takes(kind, f"a{place}", f"given[{place}]", f"{name}, {json.dumps(parameter)}", shares)
    lines += [
        f"    int status = {function.symbol}(&result, &exception{values});",
        "    if (status != 0 && status != -2)  /* numba's codes of success: OK and NONE */",
        "        raise_exception(status, exception);",
        "    else",
        f"        returned = {_boxed(function.result, 'result')};",
        "failed:",
        *(f"    release({member}.meminfo);" for leaf, member in leaves if shares and isinstance(leaf, Array)),
        "    return returned;",
        "}\n",
    ]
    return "\n".join(lines)


_START: dict[type, str] = {Scalar: " = 0", Array: " = {NULL}"}


def _variable(leaf: Scalar | Array) -> str:
    """Return the type of the variable that an argument is converted to."""
    if isinstance(leaf, Array):
        return "array_t"
    return {"float": "double", "bool": "uint8_t"}.get(leaf.kind, "int64_t")


def _leaves(kind: Type, variable: str) -> Iterator[tuple[Scalar | Array, str]]:
    """Yield the scalars and arrays of which an argument consists, and their variables."""
    if isinstance(kind, Tuple):
        for number, item in enumerate(kind.items):
            yield from _leaves(item, f"{variable}_{number}")
    else:
        yield kind, variable


def _members(leaf: Scalar | Array, variable: str) -> Iterator[tuple[str, str]]:
    """Yield types and values that numba's calling convention passes for a scalar or array."""
    if isinstance(leaf, Scalar):
        yield leaf.c_type, f"({leaf.c_type}){variable}"
        return
    yield from (("void *", f"{variable}.{name}") for name in ("meminfo", "parent"))
    yield from (("int64_t", f"{variable}.{name}") for name in ("items", "item_bytes"))
    yield "void *", f"{variable}.data"
    yield from (("npy_intp", f"{variable}.extents[{number}]") for number in range(2 * leaf.dimensions))


def _takes(kind: Type, variable: str, given: str, place: str, shares: bool) -> Iterator[str]:
    """Yield statements that convert an argument, or go to ``failed`` with an exception."""
    if isinstance(kind, Tuple):
        count = len(kind.items)
        condition = f"!PyTuple_Check({given}) || PyTuple_GET_SIZE({given}) != {count}"
    elif isinstance(kind, Array):
        scalar = Scalar(kind.dtype)
        element = f"'{KINDS[scalar.kind]}', {_bytes(kind.dtype)}"
        flags = f"{kind.dimensions}, {kind.writes:d}, {shares:d}"
        condition = f"take_array({given}, {element}, {flags}, &{variable})"
    else:
        take = {"float": "take_float", "bool": "take_boolean"}.get(kind.kind, "take_integer")
        condition = f"{take}({given}, &{variable})"
    yield f"    if ({condition}) {{ refuse({place}, {json.dumps(describe(kind))}, {given}); goto failed; }}"
    if isinstance(kind, Tuple):
        for number, item in enumerate(kind.items):
            yield from _takes(
                item, f"{variable}_{number}", f"PyTuple_GET_ITEM({given}, {number})", place, shares
            )


def describe(kind: Type) -> str:
    """Return what an argument must be, for an error message."""
    if isinstance(kind, Tuple):
        return f"a tuple of {len(kind.items)} items"
    if isinstance(kind, Scalar):
        return "a number"
    writes = ", writable" if kind.writes else ""
    return f"a contiguous{writes}, {kind.dimensions}-dimensional array of {kind.dtype}"


def _c_type(kind: Type | None) -> str:
    """Return the type of a result in C."""
    if kind is None:
        return "void *"
    if isinstance(kind, Scalar):
        return kind.c_type
    if isinstance(kind, Array):
        return f"ARRAY({kind.dimensions})"
    members = "".join(f"{_c_type(item)} i{number}; " for number, item in enumerate(kind.items))
    return f"struct {{ {members}}}"


def _boxed(kind: Type | None, value: str) -> str:
    """Return the expression that makes a Python object of a result."""
    if kind is None:
        return "Py_NewRef(Py_None)"
    if isinstance(kind, Array):
        return f"box_array(&{value}, NPY_{kind.dtype.upper()}, {kind.dimensions}, {kind.writes:d})"
    if isinstance(kind, Tuple):
        items = ", ".join(_boxed(item, f"{value}.i{number}") for number, item in enumerate(kind.items))
        return f"box_tuple({len(kind.items)}, (PyObject *[]){{{items}}})"
    make = {"float": "PyFloat_FromDouble", "bool": "PyBool_FromLong", "uint": "PyLong_FromUnsignedLongLong"}
    return f"{make.get(kind.kind, 'PyLong_FromLongLong')}({value})"


def _has_array(kind: Type | None) -> bool:
    """Whether a result has an array."""
    return isinstance(kind, Array) or (isinstance(kind, Tuple) and any(map(_has_array, kind.items)))


def _bytes(dtype: str) -> int:
    """Return the size of an element."""
    return 1 if dtype == "bool" else int(dtype.lstrip("abcdefghijklmnopqrstuvwxyz")) // 8
