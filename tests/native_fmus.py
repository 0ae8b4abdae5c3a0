"""FMUs that need no Python, for the tests, and how they are compared with those of pythonfmu."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fmus import MS, Instance, Store

from build_fmu import build, build_native
from fmu_src import compiler
from fmu_src.native.binaries import here, sources
from solver import Network
from solver.tracing.native import ENGINES

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="needs a C compiler (cc)")


def can_build() -> bool:
    """Whether a native FMU of this machine can be built: there is a compiler, or the binary of a wheel."""
    name = here()
    if name is None or compiler.own() or compiler.ziglang():
        return name is not None
    return (ENGINES / compiler.fmu_library(name, sources(), compiler.PLATFORMS[name].target)).is_file()


def pair(stored: Store, network: Network, folder: Path) -> tuple[Instance, Instance]:
    """Instances of both FMUs of a network: pythonfmu's and the native one."""
    return Instance(stored(build, network), folder / "a"), Instance(stored(build_native, network), folder / "b")


def half_sine(t: float) -> float:
    return 55e-6 * max(0.0, float(np.sin(2 * np.pi * t / 0.5)))


def rows(
    instance: Instance,
    start: Mapping[str, float | str],
    steps: int,
    h: float = MS,
    tuned: Mapping[int, Mapping[str, float]] | None = None,
) -> np.ndarray:
    """All outputs at all communication points; inlet.Q(t + h) is set before each step, and at some steps parameters."""
    instance.slave.reset()
    instance.messages.clear()
    instance.initialize(start)
    names = [*instance.outputs, *instance.others]
    found = [instance.get(names)]
    for i in range(steps):
        instance.set((tuned or {}).get(i, {}))
        if start.get("inlet.drive") != "network":
            instance.set({"inlet.Q": half_sine((i + 1) * h)})
        instance.slave.doStep(i * h, h)
        found.append(instance.get(names))
    return np.array(found)


def apart(one: Instance, found: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """The largest difference of pressures, flows and radii, by the largest value of each, and of the other outputs."""
    n, size = len(one.outputs), np.abs(expected).max(axis=0)
    off = np.abs(found - expected).max(axis=0) / np.where(size > 0.0, size, 1.0)
    return float(off[:n].max()), float(off[n:].max())


def elastic(network: Network) -> Network:
    return replace(
        network.with_parameters({f"{s.name}.phi0": 0.0 for s in network.segments}), name=f"{network.name}_elastic"
    )
