"""Arrays without numbers: NumPy code runs on them once and is recorded.

The ``index`` of a :class:`Traced` array gives the places of its numbers in a buffer, so that NumPy itself computes
shapes, on the index. A :class:`~solver.tracing.recorder.Recorder` records the computations: elementwise operations,
gathers, scatters, sums, small matrix products and inverses.

Code that needs numbers, such as a branch on them, raises :class:`Untraceable`. ``all()`` is assumed to be true, and the
program checks it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from .recorder import CONSTANT, Buffer, Instruction, Operand, Recorder, Slot, Untraceable, View, up_to

Array = np.ndarray


def _on_index(name: str) -> Callable[..., Any]:
    """A method that changes the shape."""
    return lambda self, *given: self._view(getattr(self.index, name)(*given))


def _reduction(name: str) -> Callable[..., Any]:
    """A method that combines the numbers along axes."""
    return lambda self, axis=None: _reduced(self.recorder, name, self, axis=axis)


class Traced(View, NDArrayOperatorsMixin):
    """An array whose numbers are not yet known."""

    __array_priority__ = 1000.0

    # --- shape: NumPy's own, on the index ---------------------------------------------------------------------------

    @property
    def shape(self) -> tuple[int, ...]:
        return self.index.shape

    @property
    def ndim(self) -> int:
        return self.index.ndim

    @property
    def size(self) -> int:
        return self.index.size

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(float)

    @property
    def T(self) -> Traced:
        return self._view(self.index.T)

    @property
    def real(self) -> Traced:
        return self

    def __len__(self) -> int:
        return len(self.index)

    def _view(self, index: Array) -> Traced:
        return Traced(self.recorder, self.buffer, index)

    reshape, swapaxes, transpose = map(_on_index, ("reshape", "swapaxes", "transpose"))

    def take(self, at: Any, axis: int | None = None) -> Traced:
        return self._view(self.index.take(at, axis)).copy()

    def ravel(self) -> Traced:
        return self._view(self.index.reshape(-1))

    def astype(self, kind: Any) -> Traced:
        if kind is not Traced and np.dtype(kind) != float:
            raise Untraceable(f"an array becomes {np.dtype(kind)}")
        return self.copy()

    def copy(self) -> Traced:
        """The same numbers, independent of later writes to this array."""
        slot = self.recorder.operand(self, self.shape)
        if slot.single or slot.start or slot.slot.size != self.size:
            return elementwise(self.recorder, "copy", self)
        if slot.slot is self.buffer.slot:
            self.buffer.own = False  # the first writer makes a copy
        return of(self.recorder, slot.slot, self.shape)

    def __getitem__(self, key: Any) -> Traced:
        index = self.index[key]
        basic = all(isinstance(k, (int, slice, type(None), type(...), np.integer))
                    for k in (key if isinstance(key, tuple) else (key,)))  # fmt: skip
        found = self._view(np.asarray(index))
        return found if basic else found.copy()

    def __setitem__(self, key: Any, value: Any) -> None:
        self.recorder.assign(self._view(np.asarray(self.index[key])), value)

    # --- numbers, which are unknown ---------------------------------------------------------------------------------

    def _unknown(self, *_: Any, **__: Any) -> Any:
        return self.recorder.look(self)

    __array__ = __int__ = __index__ = item = tolist = argmin = argmax = _unknown

    def __float__(self) -> float:
        return float(self.recorder.look(self, "number"))

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))

    def __bool__(self) -> bool:
        return bool(self.recorder.look(self))

    # --- operations -------------------------------------------------------------------------------------------------

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **options: Any) -> Any:
        found: Any
        if any(hasattr(x, "has_two_parts") for x in inputs):  # a Complex, which implements the operation
            return NotImplemented
        if method == "reduce":
            found = _reduced(self.recorder, ufunc.__name__, inputs[0], **options)
        elif method == "reduceat" and ufunc is np.add:
            found = _sums(self.recorder, inputs[0], *inputs[1:], **options)
        elif method == "__call__" and out is not None and list(options) == ["where"]:
            found = elementwise(self.recorder, "where", options["where"], getattr(ufunc, method)(*inputs), out[0])
        elif method != "__call__" or options:
            raise Untraceable(f"{ufunc.__name__}.{method} with {', '.join(options)}")
        elif ufunc is np.matmul:
            found = _matmul(self.recorder, *inputs)
        else:
            found = _elementwise(self.recorder, ufunc.__name__, inputs)
        if out is None:
            return found
        if not isinstance(out[0], Traced):
            raise Untraceable("a result goes into an array of numbers; make it like one of the operands (zeros_like)")
        self.recorder.assign(out[0], found)
        return out[0]

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> Any:
        if any(hasattr(kind, "has_two_parts") for kind in types):
            return NotImplemented
        if function in _ON_INDEX:
            return self._view(function(self.index, *inputs[1:], **options))
        if function not in _FUNCTIONS:
            raise Untraceable(f"np.{function.__name__} is not recorded")
        return _FUNCTIONS[function](self.recorder, *inputs, **options)

    sum, max, min = map(_reduction, ("add", "maximum", "minimum"))

    def any(self, axis: Any = None) -> Traced:
        found = _reduced(self.recorder, "logical_or", self != 0.0, axis=axis)
        return _Any(self.recorder, found.buffer, found.index)

    def all(self, axis: Any = None) -> Traced:
        found = _reduced(self.recorder, "logical_and", self != 0.0, axis=axis)
        return _Guard(self.recorder, found) if axis is None else found


class _Any(Traced):
    """True if any element is; a branch on it may be recorded."""

    def __bool__(self) -> bool:
        return bool(self.recorder.look(self, "any"))


class _Guard(Traced):
    """A condition that a branch assumes to be true while it is unknown; the program stops if it is false."""

    def __init__(self, recorder: Recorder, condition: Traced) -> None:
        super().__init__(recorder, condition.buffer, condition.index)

    def __bool__(self) -> bool:
        try:
            return bool(self.recorder.look(self))
        except Untraceable:
            self.recorder.emit("require", (self.recorder.operand(self, ()),), (1,), 1)
            return True


def of(r: Recorder, slot: Slot, shape: tuple[int, ...]) -> Traced:
    """The numbers of a slot as an array."""
    return Traced(r, Buffer(slot), up_to(slot.size).reshape(shape), True)


def array(r: Recorder, phase: int, shape: tuple[int, ...]) -> Traced:
    """An input array of the program, given before a phase."""
    return of(r, Slot(math.prod(shape), phase), shape)


def later(r: Recorder, x: Any, phase: int) -> Any:
    """The same array in a later phase, to which computations with it then belong."""
    slot = Slot(x.size, phase)
    r.write(Instruction("copy", slot, 0, (r.operand(x, x.shape),), (x.size,)))
    return of(r, slot, x.shape)


# --- NumPy functions as operations --------------------------------------------------------------------------------

ELEMENTWISE = (
    "copy negative sqrt exp expm1 log log1p absolute sign square reciprocal sin cos sinh cosh tanh logical_not "
    "isfinite add subtract multiply divide power maximum minimum greater greater_equal less less_equal equal not_equal "
    "logical_and logical_or where"
).split()
_ELEMENTWISE = frozenset(ELEMENTWISE)
_ALIASES = {
    "positive": "copy", "fabs": "absolute", "true_divide": "divide", "invert": "logical_not", "conjugate": "copy",
    "bitwise_and": "logical_and", "bitwise_or": "logical_or", "float_power": "power",
}  # fmt: skip
_POWERS = {2: "square", 0.5: "sqrt", 1: "copy", -1: "reciprocal"}  # as in NumPy
_OF_NOTHING = {"add": 0.0, "logical_and": 1.0, "logical_or": 0.0}
REDUCED = {"add": "sum", "maximum": "largest", "minimum": "least", "logical_and": "least", "logical_or": "largest"}


def elementwise(r: Recorder, name: str, *values: Any) -> Traced:
    """An elementwise operation on ``values``, broadcast to one shape."""
    shapes = [v.index.shape if isinstance(v, View) else np.shape(v) for v in values]
    different = {each for each in shapes if each}
    shape = np.broadcast_shapes(*different) if len(different) > 1 else different.pop() if different else ()
    size = math.prod(shape)
    return of(r, r.emit(name, tuple(r.operand(v, shape) for v in values), (size,), size), shape)


def _elementwise(r: Recorder, name: str, inputs: Sequence[Any]) -> Traced:
    name = _ALIASES.get(name, name)
    if name == "power" and np.ndim(inputs[1]) == 0 and not isinstance(inputs[1], Traced) and inputs[1] in _POWERS:
        name, inputs = _POWERS[inputs[1]], inputs[:1]
    if name not in _ELEMENTWISE:
        raise Untraceable(f"np.{name} is not recorded")
    if name == "divide":  # many divisions share a divisor, whose reciprocal is computed once
        with np.errstate(divide="ignore"):
            inverse = (
                _elementwise(r, "reciprocal", inputs[1:])
                if isinstance(inputs[1], Traced)
                else 1.0 / np.asarray(inputs[1])
            )
        return elementwise(r, "multiply", inputs[0], inverse)
    return elementwise(r, name, *inputs)


def _reduced(r: Recorder, name: str, x: Traced, axis: Any = 0, keepdims: bool = False, **options: Any) -> Traced:
    if name not in REDUCED or any(value is not None for value in options.values()):
        raise Untraceable(f"np.{name}.reduce is not recorded")
    axes = tuple(range(x.ndim)) if axis is None else axis if isinstance(axis, tuple) else (axis,)
    last = np.moveaxis(x.index, axes, range(-len(axes), 0)) if axes else x.index
    outer, count = last.shape[: x.ndim - len(axes)], math.prod(last.shape[x.ndim - len(axes) :])
    if count == 0:
        if name not in _OF_NOTHING:
            raise Untraceable("the largest of nothing")
        return of(r, r.constant(np.full(outer, _OF_NOTHING[name])), outer)
    size = math.prod(outer)
    found = of(r, r.emit(REDUCED[name], (r.operand(x._view(last), last.shape),), (size, count), size), outer)
    return found.reshape(np.expand_dims(found.index, axes).shape) if keepdims else found


def _sums(r: Recorder, x: Traced, first: Array, axis: int = 0, **options: Any) -> Traced:
    """np.add.reduceat along the last axis of one row."""
    if math.prod(x.shape[:-1]) != 1 or axis not in (x.ndim - 1, -1):
        raise Untraceable("np.add.reduceat along other axes")
    bounds = np.append(first, x.size)
    shape = (*x.shape[:-1], len(first))
    return of(r, r.emit("sums", (r.operand(x, x.shape),), (len(first), x.size), len(first), bounds), shape)


def _matmul(r: Recorder, a: Any, b: Any) -> Traced:
    if np.ndim(a) == 1 or np.ndim(b) == 1:
        rows, columns = (a[None] if np.ndim(a) == 1 else a), (b[:, None] if np.ndim(b) == 1 else b)
        found = _matmul(r, rows, columns)
        found = found[..., 0] if np.ndim(b) == 1 else found
        return found[..., 0, :] if np.ndim(a) == 1 and np.ndim(b) > 1 else found
    (m, k), n = np.shape(a)[-2:], np.shape(b)[-1]
    batch, shape_a, shape_b = np.broadcast_shapes(np.shape(a)[:-2], np.shape(b)[:-2]), np.shape(a), np.shape(b)
    count, shape = math.prod(batch), (*batch, m, n)
    each_a, each_b = math.prod(shape_a[:-2]) > 1, math.prod(shape_b[:-2]) > 1
    if each_a and not each_b:  # one matrix for all: a tall product
        m, count, each_a = m * count, 1, False
    elif count > 1:
        shape_a, shape_b = ((*batch, *s[-2:]) if each else s for s, each in ((shape_a, each_a), (shape_b, each_b)))
    one, two = (_spread(r, r.operand(x, s), math.prod(s)) for x, s in ((a, shape_a), (b, shape_b)))
    return of(r, r.emit("product", (one, two), (count, m, k, n, int(each_a), int(each_b)), count * m * n), shape)


def _spread(r: Recorder, operand: Operand, size: int) -> Operand:
    """An operand with all its numbers, if it repeats a single one."""
    if not operand.single or size == 1:
        return operand._replace(single=False)
    return Operand(r.emit("copy", (operand,), (size,), size), 0, False)


def _einsum(r: Recorder, formula: str, a: Any, b: Any) -> Traced:
    """A product of two arrays as a matrix product."""
    given, found = formula.split("->")
    one, two = given.split(",")
    size = dict(zip([*one, *two], [*np.shape(a), *np.shape(b)], strict=True))
    both = [c for c in one if c in two and c in found]
    gone = [c for c in one if c in two and c not in found]
    left, right = [c for c in one if c not in two], [c for c in two if c not in one]
    if {*both, *left, *right} != {*found}:
        raise Untraceable(f"np.einsum {formula}")

    def count(letters: Sequence[str]) -> int:
        return math.prod(size[c] for c in letters)

    def laid(x: Any, letters: str, order: Sequence[str], shape: tuple[int, ...]) -> Any:
        return x.transpose([letters.index(c) for c in order]).reshape(shape)

    if both and not right:  # a matrix each times a vector each: the vector from the left, along the rows of the matrix
        a, b, one, two, left, right = b, a, two, one, right, left
    rows = laid(a, one, [*both, *left, *gone], (count(both), count(left), count(gone)))
    columns = laid(b, two, [*both, *gone, *right], (count(both), count(gone), count(right)))
    order = [*both, *left, *right]
    product = _matmul(r, rows, columns).reshape([size[c] for c in order])
    return product.transpose([order.index(c) for c in found])


def _inverse(r: Recorder, x: Traced) -> Traced:
    count, n = math.prod(x.shape[:-2]), x.shape[-1]
    found = r.emit("inverse", (_spread(r, r.operand(x, x.shape), x.size),), (count, n), x.size + n)  # with its pivots
    return Traced(r, Buffer(found), np.arange(x.size).reshape(x.shape))


def _joined(r: Recorder, arrays: Sequence[Any], axis: int = 0) -> Traced:
    shapes = [np.shape(x) for x in arrays]
    places = np.split(np.arange(sum(map(math.prod, shapes))), np.cumsum([math.prod(s) for s in shapes])[:-1])
    index = np.concatenate([p.reshape(s) for p, s in zip(places, shapes, strict=True)], axis)
    found = _like(r, None, shape=index.shape)
    position = np.empty(index.size, int)
    position[index.ravel()] = np.arange(index.size)
    for x, place in zip(arrays, places, strict=True):
        r.assign(found._view(position[place].reshape(np.shape(x))), x)
    return found


def _stacked(r: Recorder, arrays: Sequence[Any], axis: int = 0) -> Traced:
    return _joined(r, [np.expand_dims(x, axis) for x in arrays], axis)


def _like(r: Recorder, x: Any, dtype: Any = float, *, shape: Any = None) -> Traced:
    """An array whose numbers are written later."""
    shape = np.shape(x) if shape is None else shape
    return of(r, Slot(math.prod(shape), CONSTANT), shape)


def _full(value: float) -> Callable[..., Traced]:
    def like(r: Recorder, x: Any, dtype: Any = float, *, shape: Any = None) -> Traced:
        shape = np.shape(x) if shape is None else shape
        return of(r, r.constant(np.full(shape, value)), shape)

    return like


def _together(r: Recorder, *arrays: Any) -> tuple[Any, ...]:
    shape = np.broadcast_shapes(*map(np.shape, arrays))
    return tuple(np.broadcast_to(x, shape) for x in arrays)


_ON_INDEX = {np.swapaxes, np.moveaxis, np.broadcast_to, np.expand_dims, np.reshape, np.transpose, np.ravel, np.squeeze,
             np.atleast_2d, np.atleast_1d}  # fmt: skip
_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: lambda r, *values: elementwise(r, "where", *values),
    np.einsum: _einsum,
    np.linalg.inv: _inverse,
    np.concatenate: _joined,
    np.stack: _stacked,
    np.empty_like: _like,
    np.zeros_like: _full(0.0),
    np.ones_like: _full(1.0),
    np.clip: lambda r, x, low, high: elementwise(r, "minimum", elementwise(r, "maximum", x, low), high),
    np.sum: lambda r, x, axis=None: x.sum(axis),
    np.max: lambda r, x, axis=None: x.max(axis),
    np.min: lambda r, x, axis=None: x.min(axis),
    np.all: lambda r, x, axis=None: x.all(axis),
    np.any: lambda r, x, axis=None: x.any(axis),
    np.broadcast_arrays: _together,
    np.unique: lambda r, x, **options: np.unique(r.look(x, "number"), **options),
    np.shape: lambda r, x: x.shape,
    np.ndim: lambda r, x: x.ndim,
    np.size: lambda r, x: x.size,
    np.result_type: lambda r, *_: np.dtype(float),
    np.copy: lambda r, x: x.copy(),
    np.nan_to_num: lambda r, x, nan=0.0: elementwise(r, "where", x == x, x, nan),
}
