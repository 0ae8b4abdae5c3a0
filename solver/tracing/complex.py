"""Complex arrays without numbers: two arrays of :class:`~solver.tracing.array.Traced`, recorded as real operations.

They arise if the length of a stage is complex, 1/iω: quantities that depend on frequency are complex, others real.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from .recorder import Untraceable


def _of_each(name: str) -> Callable[..., Any]:
    """A method that does the same to both parts."""
    return lambda self, *given, **how: Complex(*(getattr(x, name)(*given, **how) for x in (self.re, self.im)))


class Complex(NDArrayOperatorsMixin):
    """re + i im, of one shape."""

    has_two_parts = True

    def __init__(self, re: Any, im: Any) -> None:
        self.re = self.real = re
        self.im = self.imag = im

    @property
    def shape(self) -> tuple[int, ...]:
        return np.shape(self.re)

    @property
    def ndim(self) -> int:
        return len(self.shape)

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    @property
    def T(self) -> Complex:
        return Complex(self.re.T, self.im.T)

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Any:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, key: Any) -> Complex:
        return Complex(self.re[key], self.im[key])

    def __setitem__(self, key: Any, value: Any) -> None:
        self.re[key], self.im[key] = parts(value)

    reshape, swapaxes, transpose, take, ravel, copy, sum = map(
        _of_each, ("reshape", "swapaxes", "transpose", "take", "ravel", "copy", "sum")
    )

    def all(self, axis: Any = None) -> Any:
        """True if no element is 0; a guard if ``axis`` is None."""
        return ((self.re != 0.0) | (self.im != 0.0)).all(axis)

    def _unknown(self, *_: Any, **__: Any) -> Any:
        raise Untraceable("a number is asked for that depends on the frequency")

    __array__ = __float__ = __int__ = __index__ = __bool__ = item = tolist = _unknown

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **options: Any) -> Any:
        name, found = ufunc.__name__, None
        if method == "__call__" and not options:
            found = _OPERATIONS.get(name, _none)(*inputs)
        elif method in ("reduceat", "reduce") and ufunc is np.add:
            found = Complex(*(getattr(np.add, method)(part, *inputs[1:], **options) for part in parts(inputs[0])))
        if found is None:
            raise Untraceable(f"np.{name}.{method} of complex numbers is not recorded")
        if out is None:
            return found
        if not isinstance(out[0], Complex):
            raise Untraceable("complex numbers go into an array of real ones")
        out[0][...] = found
        return out[0]

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> Any:
        if function in _FUNCTIONS:
            return _FUNCTIONS[function](*inputs, **options)
        if function in _OF_EACH:
            return Complex(*(function(part, *inputs[1:], **options) for part in (self.re, self.im)))
        raise Untraceable(f"np.{function.__name__} of complex numbers is not recorded")


def parts(x: Any) -> tuple[Any, Any]:
    """Real and imaginary part; the latter is 0.0 for real numbers."""
    if isinstance(x, Complex):
        return x.re, x.im
    if isinstance(x, np.ndarray | complex) and np.iscomplexobj(x):
        return np.real(x), np.imag(x)
    return x, 0.0


def _is(x: Any) -> bool:
    return isinstance(x, Complex) or np.iscomplexobj(x) if not hasattr(x, "recorder") else False


# --- operations ---------------------------------------------------------------------------------------------------


def _none(*_: Any) -> None:
    return None


def _add(a: Any, b: Any) -> Complex:
    (a, c), (b, d) = parts(a), parts(b)
    return _like(a + b, c + d)


def _subtract(a: Any, b: Any) -> Complex:
    (a, c), (b, d) = parts(a), parts(b)
    return _like(a - b, c - d)


def _like(re: Any, im: Any) -> Complex:
    """Both parts broadcast to their common shape."""
    shape = np.broadcast_shapes(np.shape(re), np.shape(im))
    return Complex(*(x if np.shape(x) == shape else np.broadcast_to(x, shape) for x in (re, im)))


def _product(times: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Complex]:
    """A bilinear operation."""

    def of(a: Any, b: Any) -> Complex:
        if not _is(a):
            return Complex(times(a, b.real), times(a, b.imag))
        if not _is(b):
            return Complex(times(a.real, b), times(a.imag, b))
        (a, c), (b, d) = parts(a), parts(b)
        return Complex(times(a, b) - times(c, d), times(a, d) + times(c, b))

    return of


_times = _product(lambda a, b: a * b)


def _reciprocal(a: Complex) -> Complex:
    scale = 1.0 / (a.re * a.re + a.im * a.im)
    return Complex(a.re * scale, -(a.im * scale))


def _divide(a: Any, b: Any) -> Complex:
    return _times(a, _reciprocal(b) if isinstance(b, Complex) else 1.0 / b)


def _power(a: Any, n: Any) -> Complex | None:
    return _times(a, a) if np.ndim(n) == 0 and not hasattr(n, "recorder") and n == 2 else None


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": _add,
    "subtract": _subtract,
    "multiply": _times,
    "divide": _divide,
    "true_divide": _divide,
    "matmul": _product(lambda a, b: a @ b),
    "negative": lambda a: Complex(-a.re, -a.im),
    "positive": lambda a: a.copy(),
    "reciprocal": _reciprocal,
    "square": lambda a: _times(a, a),
    "power": _power,
    "conjugate": lambda a: Complex(a.re, -a.im),
}


# --- functions ----------------------------------------------------------------------------------------------------


def _einsum(formula: str, a: Any, b: Any) -> Complex:
    return _product(lambda x, y: np.einsum(formula, x, y))(a, b)


def _inverse(a: Complex) -> Complex:
    """By the real matrix [[re, -im], [im, re]] of twice the size."""
    n = a.shape[-1]
    whole = np.concatenate([np.concatenate([a.re, -a.im], axis=-1), np.concatenate([a.im, a.re], axis=-1)], axis=-2)
    found = np.linalg.inv(whole)
    return Complex(found[..., :n, :n], found[..., n:, :n])


def _joined(join: Callable[..., Any]) -> Callable[..., Complex]:
    def of(arrays: Any, axis: int = 0) -> Complex:
        return Complex(*(join([np.broadcast_to(part, np.shape(x)) for x, part in zip(arrays, each, strict=True)], axis)
                         for each in zip(*map(parts, arrays), strict=True)))  # fmt: skip

    return of


def _where(condition: Any, a: Any, b: Any) -> Complex:
    return Complex(*(np.where(condition, x, y) for x, y in zip(parts(a), parts(b), strict=True)))


def _made(make: Callable[..., Any], im: Callable[..., Any]) -> Callable[..., Any]:
    def like(x: Any, dtype: Any = Complex, *, shape: Any = None) -> Any:
        shape, real = np.shape(x) if shape is None else shape, parts(x)[0]
        return Complex(make(real, shape=shape), im(real, shape=shape))

    return like


_OF_EACH = {np.swapaxes, np.moveaxis, np.broadcast_to, np.expand_dims, np.reshape, np.transpose, np.ravel, np.squeeze,
            np.atleast_2d, np.atleast_1d, np.sum, np.copy}  # fmt: skip
zeros_like, ones_like = _made(np.zeros_like, np.zeros_like), _made(np.ones_like, np.zeros_like)
_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.einsum: _einsum,
    np.linalg.inv: _inverse,
    np.concatenate: _joined(np.concatenate),
    np.stack: _joined(np.stack),
    np.where: _where,
    np.zeros_like: zeros_like,
    np.ones_like: ones_like,
    np.empty_like: _made(np.empty_like, np.empty_like),
    np.shape: lambda x: x.shape,
    np.ndim: lambda x: x.ndim,
    np.size: lambda x: x.size,
    np.all: lambda x, axis=None: x.all(axis),
    np.result_type: lambda *_: Complex,
}
