"""A host of one step, with nothing but Python's own library: ``python trial.py FOLDER``, an FMU's unpacked folder.

Prints one JSON object a line, ``{"done": …}`` after each stage and ``{"said": …}`` for what the FMU logs, so that what
was reached is known even where the process dies. It is run by the doctor under the interpreter in question.
"""

import json
import sys
from ctypes import CDLL, CFUNCTYPE, POINTER, Structure, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from xml.etree import ElementTree

LOGGER = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)


class Callbacks(Structure):
    """What the host gives the FMU: fmi2CallbackFunctions."""

    _fields_ = [
        ("logger", LOGGER),
        ("allocate", c_void_p),
        ("release", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]


def tell(**what: object) -> None:
    print(json.dumps(what), flush=True)


def binary(folder: Path, model: str) -> Path:
    """The FMU's library for this machine."""
    platform, suffix = {"win32": ("win64", "dll"), "darwin": ("darwin64", "dylib")}.get(sys.platform, ("linux64", "so"))
    return folder / "binaries" / platform / f"{model}.{suffix}"


def main(folder: Path) -> None:
    root = ElementTree.parse(folder / "modelDescription.xml").getroot()
    simulation, experiment = root.find("CoSimulation"), root.find("DefaultExperiment")
    if simulation is None:
        raise SystemExit("modelDescription.xml: has no CoSimulation.")
    step = float(experiment.get("stepSize", "1e-3")) if experiment is not None else 1e-3
    outputs = [
        int(variable.get("valueReference", "0"))
        for variable in root.iterfind("ModelVariables/ScalarVariable")
        if variable.get("causality") == "output" and variable.find("Real") is not None
    ]

    fmi = CDLL(str(binary(folder, simulation.get("modelIdentifier", ""))))
    tell(done="load")
    heard = LOGGER(lambda _e, _n, _s, _c, text: tell(said=(text or b"").decode("utf-8", "replace")))
    callbacks = Callbacks(heard)
    fmi.fmi2Instantiate.restype = c_void_p
    fmi.fmi2Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, POINTER(Callbacks), c_int, c_int]
    uri = (folder / "resources").as_uri()
    component = c_void_p(
        fmi.fmi2Instantiate(b"trial", 1, (root.get("guid") or "").encode(), uri.encode(), callbacks, 0, 1)
    )

    def call(stage: str, function: str, *arguments: object) -> None:
        status = getattr(fmi, function)(component, *arguments)
        if status > 1:
            raise SystemExit(f"{function} gave status {status}.")
        tell(done=stage)

    if not component:
        raise SystemExit("fmi2Instantiate gave no instance.")
    tell(done="instantiate")
    call("set up", "fmi2SetupExperiment", c_int(0), c_double(0.0), c_double(0.0), c_int(0), c_double(0.0))
    call("enter", "fmi2EnterInitializationMode")
    call("initialize", "fmi2ExitInitializationMode")
    call("step", "fmi2DoStep", c_double(0.0), c_double(step), c_int(1))
    values = (c_double * len(outputs))()
    call("read", "fmi2GetReal", (c_uint * len(outputs))(*outputs), c_size_t(len(outputs)), values)
    call("terminate", "fmi2Terminate")
    fmi.fmi2FreeInstance.restype = None
    fmi.fmi2FreeInstance(component)
    tell(done="free")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
