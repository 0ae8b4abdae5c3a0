"""Build the FMU that a check runs: with the compiled engine if possible, since that one needs 30 µs a step, not 1 ms.

Both kinds have the same variables and agree to round-off; the one of pythonfmu is the reference, and the one that
``arterial-fmu build`` makes by default. Each build uses a new process, because pythonfmu's builder imports its code.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from solver.errors import InputError
from solver.io.exit_codes import ended
from solver.network.files import find_network, read_network, write_network
from solver.tracing.native import NoEngine, check_backend, library, refuse_without

from .fmu_run import FMU, Answer, Array, RunFailed, periodic_answer, read_fmu, run_module, takes

_LAWS = ("elastic_law", "viscous_law")


def build_fmu(network_file: Path, folder: Path, backend: str = "numpy") -> Path:
    """Build the FMU of a network file in a separate process: ``<folder>/<name>.fmu``.

    backend : "numpy", the FMU of pythonfmu; "native", the one with the compiled engine; "auto", native if this machine
    has the engine and can build it for this network, otherwise numpy.
    Raises ValueError with the message of the process, and for "native" without the engine.
    """
    check_backend(backend)
    line = ["build_fmu", os.fspath(network_file), "--out", os.fspath(folder), "--quiet"]
    if _has_engine(backend):
        code, message = run_module(*line, "--native")
        if code == 0 or backend == "native":
            return _built(network_file, folder, code, message)
    return _built(network_file, folder, *run_module(*line))


def _has_engine(backend: str) -> bool:
    if backend == "numpy":
        return False
    try:
        library()
    except NoEngine as reason:
        if backend == "native":
            refuse_without(reason)
        return False
    return True


def _built(network_file: Path, folder: Path, code: int, message: str) -> Path:
    if code != 0:
        raise InputError(message or f"{network_file}: its FMU could not be built; the process {ended(code)}.")
    return folder / f"{read_network(network_file).name}.fmu"


@contextmanager
def fmu_of(source: str | os.PathLike[str], backend: str) -> Iterator[Path]:
    """The path of an FMU: the given one, or the one built of a network file or a bundled network, which exists until
    the end of the context.

    backend : as in :func:`build_fmu`.
    """
    if Path(source).suffix.lower() not in ("", ".toml"):
        yield Path(source)
        return
    network_file = find_network(source)
    with TemporaryDirectory(prefix="check_", ignore_cleanup_errors=True) as folder:
        yield build_fmu(network_file, Path(folder), backend)


@contextmanager
def answering(
    fmu: FMU, driver: str, beat: Array, T: float, starts: Mapping[str, float | str]
) -> Iterator[tuple[FMU, Answer]]:
    """The FMU that runs with these start values and its periodic response to a beat, see :func:`periodic_answer`.

    An FMU with the compiled engine has the elements, the terms and the periodic start of the values that it was built
    with. If it does not take the elements and terms of ``starts``, another one is built with them. If no run from rest
    reaches the periodic beat, pythonfmu's is built, which can start from any periodic beat. Both exist until the end.
    Raises RunFailed with the FMU's sentence.
    """
    with with_starts(fmu, starts) as running:
        try:
            answer = periodic_answer(running, driver, beat, T, starts)
        except RunFailed as error:
            if not fmu.native:
                raise
            failed = error
        else:
            yield running, answer
            return
    with TemporaryDirectory(prefix="check_", ignore_cleanup_errors=True) as folder:
        file = Path(folder) / "network.toml"
        write_network(read_network(Path(fmu.path)), file)
        other = read_fmu(build_fmu(file, Path(folder)))
        try:
            answer = periodic_answer(other, driver, beat, T, starts)
        except RunFailed:
            raise failed from None  # the sentence of the FMU that was given
        yield other, answer


@contextmanager
def with_starts(fmu: FMU, starts: Mapping[str, float | str]) -> Iterator[FMU]:
    """The FMU; if it has the compiled engine and does not take these start values, another one that was built with
    them, which exists until the end."""
    if not fmu.native or takes(fmu, starts):
        yield fmu
        return
    with TemporaryDirectory(prefix="check_", ignore_cleanup_errors=True) as folder:
        file = Path(folder) / "network.toml"
        network = read_network(Path(fmu.path))
        values = {name: float(value) for name, value in starts.items() if name in network.parameters()}
        laws: dict[str, Any] = {key: starts[f"network.{key}"] for key in _LAWS if f"network.{key}" in starts}
        try:
            write_network(replace(network.with_parameters(values), **laws), file)
            other = read_fmu(build_fmu(file, Path(folder), "native"))
        except InputError:
            other = fmu  # its run says why it does not take them
        yield other
