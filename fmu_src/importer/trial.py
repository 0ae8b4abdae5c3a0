"""A host of one step, with Python's own library only: ``python trial.py FOLDER``, an FMU's unpacked folder.

Prints one JSON object per line, ``{"done": …}`` after each stage and ``{"said": …}`` for log messages of the FMU, so
that the last stage is known even if the process dies. The doctor runs it with the interpreter in question.
"""

import json
import os
import platform
import sys
from collections.abc import Callable
from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    Structure,
    byref,
    c_bool,
    c_char_p,
    c_double,
    c_int,
    c_size_t,
    c_uint,
    c_void_p,
)
from pathlib import Path
from xml.etree import ElementTree

LOGGER = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)
LOGGER_3 = CFUNCTYPE(None, c_void_p, c_int, c_char_p, c_char_p)


class Callbacks(Structure):
    """The callbacks of the host: fmi2CallbackFunctions."""

    _fields_ = [
        ("logger", LOGGER),
        ("allocate", c_void_p),
        ("release", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]


def tell(**what: object) -> None:
    print(json.dumps(what), flush=True)


def binary(folder: Path, model: str, three: bool) -> Path:
    """The FMU's library for this machine; three : of an FMU for FMI 3.0."""
    name, suffix = {"win32": ("win64", "dll"), "darwin": ("darwin64", "dylib")}.get(sys.platform, ("linux64", "so"))
    if three:
        machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine())
        name = f"{machine}-{'windows' if suffix == 'dll' else sys.platform}"
    return folder / "binaries" / name / f"{model}.{suffix}"


def main(folder: Path) -> None:
    root = ElementTree.parse(folder / "modelDescription.xml").getroot()
    simulation, experiment = root.find("CoSimulation"), root.find("DefaultExperiment")
    if simulation is None:
        raise SystemExit("modelDescription.xml: has no CoSimulation.")
    step = float(experiment.get("stepSize", "1e-3")) if experiment is not None else 1e-3
    three = root.get("fmiVersion") == "3.0"
    outputs = [
        int(variable.get("valueReference", "0"))
        for variable in root.iterfind("ModelVariables/" + ("Float64" if three else "ScalarVariable"))
        if variable.get("causality") == "output" and (three or variable.find("Real") is not None)
    ]

    fmi = CDLL(str(binary(folder, simulation.get("modelIdentifier", ""), three)))
    tell(done="load")
    run = _with_fmi3 if three else _with_fmi2
    run(fmi, folder, root.get("instantiationToken" if three else "guid", ""), step, outputs)
    tell(done="free")


def _caller(fmi: CDLL, component: c_void_p, prefix: str) -> Callable[..., None]:
    if not component:
        raise SystemExit(f"{prefix}Instantiate gave no instance.")
    tell(done="instantiate")

    def call(stage: str, function: str, *arguments: object) -> None:
        status = getattr(fmi, prefix + function)(component, *arguments)
        if status > 1:
            raise SystemExit(f"{prefix}{function} gave status {status}.")
        tell(done=stage)

    return call


def _with_fmi2(fmi: CDLL, folder: Path, guid: str, step: float, outputs: list[int]) -> None:
    heard = LOGGER(lambda _e, _n, _s, _c, text: tell(said=(text or b"").decode("utf-8", "replace")))
    callbacks = Callbacks(heard)
    fmi.fmi2Instantiate.restype = c_void_p
    fmi.fmi2Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, POINTER(Callbacks), c_int, c_int]
    uri = (folder / "resources").as_uri()
    component = c_void_p(fmi.fmi2Instantiate(b"trial", 1, guid.encode(), uri.encode(), callbacks, 0, 1))
    call = _caller(fmi, component, "fmi2")
    call("set up", "SetupExperiment", c_int(0), c_double(0.0), c_double(0.0), c_int(0), c_double(0.0))
    call("enter", "EnterInitializationMode")
    call("initialize", "ExitInitializationMode")
    call("step", "DoStep", c_double(0.0), c_double(step), c_int(1))
    values = (c_double * len(outputs))()
    call("read", "GetReal", (c_uint * len(outputs))(*outputs), c_size_t(len(outputs)), values)
    call("terminate", "Terminate")
    fmi.fmi2FreeInstance.restype = None
    fmi.fmi2FreeInstance(component)


def _with_fmi3(fmi: CDLL, folder: Path, guid: str, step: float, outputs: list[int]) -> None:
    heard = LOGGER_3(lambda _e, _s, _c, text: tell(said=(text or b"").decode("utf-8", "replace")))
    make, flag = fmi.fmi3InstantiateCoSimulation, c_bool
    make.restype = c_void_p
    make.argtypes = [
        c_char_p,
        c_char_p,
        c_char_p,
        flag,
        flag,
        flag,
        flag,
        c_void_p,
        c_size_t,
        c_void_p,
        LOGGER_3,
        c_void_p,
    ]
    resources = f"{folder / 'resources'}{os.sep}".encode()
    made = make(b"trial", guid.encode(), resources, False, True, False, False, None, 0, None, heard, None)
    component = c_void_p(made)
    call = _caller(fmi, component, "fmi3")
    zero, no = c_double(0.0), flag(False)
    call("initialize", "EnterInitializationMode", no, zero, zero, no, zero)
    call("initialize", "ExitInitializationMode")
    flags, last = [flag() for _ in range(3)], c_double()
    call("step", "DoStep", zero, c_double(step), flag(True), *map(byref, flags), byref(last))
    n, values = c_size_t(len(outputs)), (c_double * len(outputs))()
    call("read", "GetFloat64", (c_uint * len(outputs))(*outputs), n, values, n)
    call("terminate", "Terminate")
    fmi.fmi3FreeInstance.restype = None
    fmi.fmi3FreeInstance(component)


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
