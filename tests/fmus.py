"""FMUs for the tests, and an instance of one that is driven by names."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from build_fmu import build_model, build_native_model
from fmu_src.contents.models import FMUContents
from fmu_src.cosimulation.arteries import CoSimulation
from solver import Network, Pressure, Resistance, Settings, Windkessel, load
from solver.io.writing import write_whole
from solver.network.files import read_network
from solver.scheme.outputs import venous_flow

MS = 1e-3
COARSE = Settings(dt=2e-3, element_length=0.1)
TIGHT = Settings(tolerance=1e-10)


def mixed() -> Network:
    """The sheep network at physiological pressure, with every kind of outlet."""
    outlets = {o.segment: o for o in load("sheep").outlets} | {
        "CA": Windkessel("CA", R1=3e8, C=4e-10, R2=3e9, P_venous=500.0),
        "VA1": Resistance("VA1", R=3e9),
        "VA2": Pressure("VA2", P_venous=10e3),
        "VA3": Windkessel("VA3", R1=5e7, C=3e-9, R2=6e8),
    }
    return replace(load("sheep"), name="mixed", outlets=tuple(outlets.values()), P_ref=10e3, P_0=10e3)


def venous_flows(component: CoSimulation) -> np.ndarray:
    """The flow of each outlet to its P_venous : (n_outlets,) [m³/s]."""
    return venous_flow(component.model, component.shown.state, component.last.P_venous)[0]


class Store:
    """FMUs in a folder that all processes of a run share, by what they were built from."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._found: dict[str, Path] = {}

    def __call__(self, build: Callable[..., Path], network: Network, **options: Any) -> Path:
        """The file that ``build(network, out=..., **options)`` makes, of the first process that asks for it.

        Options equal to their defaults are left out: one FMU, however its build is written.
        """
        defaults = {name: p.default for name, p in inspect.signature(build).parameters.items()}
        options = {name: value for name, value in sorted(options.items()) if value != defaults[name]}
        if options.get("settings") == Settings():
            del options["settings"]
        key = pickle.dumps((build.__name__, network, options))
        return self._once(key, lambda folder: build(network, out=folder, **options))

    def lumped(self, make: Callable[..., FMUContents], species: str = "human", fmi: int = 0) -> Path:
        """The FMU of ``make(species)``, a heart or a body. fmi : of one that needs no Python; 0 of the other."""
        return self._once(
            pickle.dumps((make.__name__, species, fmi)),
            lambda to: build_native_model(make(species, None, fmi), to) if fmi else build_model(make(species), to),
        )

    def _once(self, what: bytes, build: Callable[[Path], Path]) -> Path:
        key = hashlib.sha256(what).hexdigest()[:20]
        if key not in self._found:
            place = self._folder / key
            if not place.is_dir():
                aside = self._folder / f"{key}.{os.getpid()}"
                build(aside)
                with contextlib.suppress(OSError):  # another process was faster
                    aside.rename(place)
            (self._found[key],) = place.iterdir()
        return self._found[key]


Command = Callable[[Sequence[str]], Any]


def built_once(build: Command, folder: Path) -> Command:
    """``build FILE --out FOLDER ...`` that builds each network file once with the same options: after that the FMU is
    copied. Other command lines, and those that fail, are run as they are."""
    folder.mkdir(exist_ok=True)

    def run(line: Sequence[str]) -> Any:
        if len(line) < 4 or line[1] != "--out" or not line[0].endswith(".toml"):
            return build(line)
        file, out = Path(line[0]), Path(line[2])
        kept = folder / hashlib.sha256(pickle.dumps((file.read_bytes(), *line[3:]))).hexdigest()
        made = out / f"{read_network(file).name}.fmu"
        if kept.is_file():
            out.mkdir(parents=True, exist_ok=True)
            write_whole(made, kept.read_bytes())
            return subprocess.CompletedProcess(line, 0, "", "")
        done = build(line)
        if done.returncode == 0:
            write_whole(kept, made.read_bytes())
        return done

    return run


@lru_cache(maxsize=16)
def _description(fmu: str) -> Any:
    """Read once for all instances."""
    return fmpy.read_model_description(fmu)


class Instance:
    """An FMU extracted and instantiated, with variables by name and the log in ``messages``."""

    def __init__(self, fmu: Path, folder: Path, logging: bool = True) -> None:
        self.messages: list[str] = []
        description = _description(os.fspath(fmu))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.items = {
            v.name: {item.name: int(item.value) for item in v.declaredType.items}
            for v in description.modelVariables
            if v.type == "Enumeration"
        }
        outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        self.outputs = [name for name in outputs if name[-2:] in (".P", ".Q", ".R") and name != "venous.Q"]
        self.others = [name for name in outputs if name not in self.outputs]  # volumes and ports
        self.folder = Path(fmpy.extract(os.fspath(fmu), os.fspath(folder)))

        def log(_environment: Any, _instance: bytes, _status: int, _category: bytes, message: bytes) -> None:
            self.messages.append(message.decode())

        self.slave: FMU2Slave = fmpy.instantiate_fmu(
            os.fspath(folder), description, fmi_type="CoSimulation", logger=log, debug_logging=logging
        )

    def set(self, values: Mapping[str, float | str]) -> None:
        for name, value in values.items():
            if isinstance(value, str):
                self.slave.setInteger([self.references[name]], [self.items[name][value]])
            else:
                self.slave.setReal([self.references[name]], [value])

    def get(self, names: Sequence[str] | None = None) -> list[float]:
        return self.slave.getReal([self.references[name] for name in names or self.outputs])

    def initialize(self, values: Mapping[str, float | str] | None = None, start_time: float = 0.0) -> None:
        self.slave.setupExperiment(startTime=start_time)
        self.set(values or {})
        self.slave.enterInitializationMode()
        self.slave.exitInitializationMode()

    def step(self, i: int, Q: float, h: float = MS) -> list[float]:
        """Step number i, to the time (i + 1) h with inlet.Q = Q; the outputs there."""
        self.set({"inlet.Q": Q})
        self.slave.doStep(i * h, h)
        return self.get()


# the Enumerations, as they start in the sheep network
TEXTS = {
    "network.elastic_law": "beta",
    "network.viscous_law": "quadratic",
    "inlet.interpolation": "hold",
    "inlet.drive": "input",
    "network.start": "rest",
}


def run_python(code: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, cwd=cwd)
