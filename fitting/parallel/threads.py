"""One thread for small matrices.

The matrices here are 100 × 100: the threads of a BLAS library spend more time waiting than working, and on a busy
machine a fit takes ten times as long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

ENVIRONMENT = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
"""Environment that does the same for a new process."""


def single_threaded(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """The function, with the linear algebra of this process on one thread while it runs."""

    @wraps(function)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        with _controller().limit(limits=1):
            return function(*args, **kwargs)

    return limited


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  (a BLAS must be loaded to be found)

    return ThreadpoolController()
