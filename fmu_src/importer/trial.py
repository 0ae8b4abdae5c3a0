"""A host of one step: ``python trial.py FOLDER``, an FMU's unpacked folder. It needs Python's own library only, but for
FMUs of FMI 3.0, which have no Python, FMPy.

Prints one JSON object per line, ``{"done": …}`` after each stage and ``{"said": …}`` for log messages of the FMU, so
that the last stage is known even if the process dies. The doctor runs it with the interpreter in question.
"""

import json
import platform
import sys
from ctypes import CDLL, CFUNCTYPE, POINTER, Structure, c_char_p, c_double, c_int, c_size_t, c_uint, c_void_p
from pathlib import Path
from xml.etree import ElementTree

LOGGER = CFUNCTYPE(None, c_void_p, c_char_p, c_int, c_char_p, c_char_p)


class Callbacks(Structure):
    """The callbacks of the host: fmi2CallbackFunctions."""

    _fields_ = [
        ("logger", LOGGER),
        ("allocate", c_void_p),
        ("release", c_void_p),
        ("finished", c_void_p),
        ("environment", c_void_p),
    ]


def tell(**record: object) -> None:
    print(json.dumps(record), flush=True)


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

    if three:
        _with_fmi3(folder, step, outputs)
    else:
        fmi = CDLL(str(binary(folder, simulation.get("modelIdentifier", ""), three)))
        tell(done="load")
        _with_fmi2(fmi, folder, root.get("guid", ""), step, outputs)
    tell(done="free")


def _with_fmi2(fmi: CDLL, folder: Path, guid: str, step: float, outputs: list[int]) -> None:
    heard = LOGGER(lambda _e, _n, _s, _c, text: tell(said=(text or b"").decode("utf-8", "replace")))
    callbacks = Callbacks(heard)
    fmi.fmi2Instantiate.restype = c_void_p
    fmi.fmi2Instantiate.argtypes = [c_char_p, c_int, c_char_p, c_char_p, POINTER(Callbacks), c_int, c_int]
    uri = (folder / "resources").as_uri()
    component = c_void_p(fmi.fmi2Instantiate(b"trial", 1, guid.encode(), uri.encode(), callbacks, 0, 1))
    if not component:
        raise SystemExit("fmi2Instantiate gave no instance.")
    tell(done="instantiate")

    def call(stage: str, function: str, *arguments: object) -> None:
        status = getattr(fmi, f"fmi2{function}")(component, *arguments)
        if status > 1:
            raise SystemExit(f"fmi2{function} gave status {status}.")
        tell(done=stage)

    call("set up", "SetupExperiment", c_int(0), c_double(0.0), c_double(0.0), c_int(0), c_double(0.0))
    call("enter", "EnterInitializationMode")
    call("initialize", "ExitInitializationMode")
    call("step", "DoStep", c_double(0.0), c_double(step), c_int(1))
    values = (c_double * len(outputs))()
    call("read", "GetReal", (c_uint * len(outputs))(*outputs), c_size_t(len(outputs)), values)
    call("terminate", "Terminate")
    fmi.fmi2FreeInstance.restype = None
    fmi.fmi2FreeInstance(component)


def _with_fmi3(folder: Path, step: float, outputs: list[int]) -> None:
    import fmpy  # the FMU has no Python of its own: ours runs this

    def heard(_environment: object, _status: int, _category: bytes, text: bytes) -> None:
        tell(said=(text or b"").decode("utf-8", "replace"))

    description = fmpy.read_model_description(str(folder))
    slave = fmpy.instantiate_fmu(str(folder), description, "CoSimulation", logger=heard, debug_logging=True)
    for stage, call in (
        ("instantiate", lambda: None),
        ("initialize", slave.enterInitializationMode),
        ("initialize", slave.exitInitializationMode),
        ("step", lambda: slave.doStep(0.0, step)),
        ("read", lambda: slave.getFloat64(outputs)),
        ("terminate", slave.terminate),
    ):
        call()
        tell(done=stage)
    slave.freeInstance()


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve())
