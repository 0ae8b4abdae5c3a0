"""An FMU from the outside: its description, and its periodic response to a periodic input.

Each run of an FMU of pythonfmu uses a new process, because a process that has run one keeps its code. One with the
compiled engine has no such code and runs in this process: its steps take some 30 µs, so that a new process, and files
for inputs and results, would take most of the time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import fmi2Warning
from fmpy.model_description import ScalarVariable

from solver.errors import InputError
from solver.io.exit_codes import ExitCode, HostDied
from solver.network.description import Network
from solver.network.files import read_network
from solver.quantities.units import INFLOW
from solver.simulate import change_of

from ..parallel.threads import ENVIRONMENT
from ..records.channels.spectral import interpolated, shift

Array = np.ndarray

BEATS = (5, 10, 20, 40, 60)  # numbers of beats of successive runs, until the last two beats agree
PERIODIC = 1e-4  # largest relative change of an output between them
_SHOTS = 4  # runs with the fewest beats, to correct the start
_SLOW = 0.3, 0.99  # range of λ for slow filling, where more than 1e-3 remains after five beats
_START, _P_0 = ("network.start", "inlet.Q_mean", "inlet.T"), "network.P_0"


class RunFailed(RuntimeError):
    """The FMU did not reach its stop time; the message is the FMU's sentence, behind the name of its file. The folder
    is not in it: it may be one that was made for the run."""


@dataclass(frozen=True)
class FMU:
    """The content of modelDescription.xml. tool : the generation tool, which names the kind of FMU, pythonfmu's or the
    one with the compiled engine. inputs, parameters : names.

    starts : values of inputs and parameters; for an Enumeration the name of its item.
    outputs : names of pressures, flows and radii, without ports and volumes, which accumulate from beat to beat.
    """

    path: str
    name: str
    guid: str
    fmi: int
    tool: str
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    starts: Mapping[str, float | str]

    @property
    def native(self) -> bool:
        """True if it has the compiled engine, and this process can run it."""
        return self.fmi == 2 and self.tool.endswith("compiled engine")

    @property
    def dt(self) -> float:
        """Internal time step [s]."""
        return float(self.starts["solver.dt"])


@dataclass(frozen=True)
class Answer:
    """The last beat of a run: ``values`` : name -> (n,) [SI], sample j at time j T/n of the beat.

    beats : number of beats in the run. change : largest relative change of an output from the beat before.
    """

    values: Mapping[str, Array]
    beats: int
    change: float


def read_fmu(path: str | os.PathLike[str]) -> FMU:
    """The description of an FMU of this project. Raises ValueError, one sentence, for any other file."""
    source = os.fspath(path)
    try:
        description = fmpy.read_model_description(source)
    except OSError as error:
        raise InputError(f"{source}: cannot be read ({error.strerror or 'not a file'}); check the path.") from None
    except (zipfile.BadZipFile, KeyError):
        raise InputError(f"{source}: not an FMU; build one with arterial-fmu build.") from None
    variables = {variable.name: variable for variable in description.modelVariables}
    names = {
        kind: tuple(name for name, variable in variables.items() if variable.causality == kind)
        for kind in ("input", "parameter", "output")
    }
    if INFLOW not in names["input"] or "solver.dt" not in names["parameter"]:
        raise InputError(
            f"{source}: not an arterial FMU (it has no {INFLOW} or solver.dt); use one that arterial-fmu build makes."
        )
    return FMU(
        source,
        description.modelName,
        description.guid,
        int(float(description.fmiVersion)),
        description.generationTool or "an unknown tool",
        names["input"],
        names["parameter"],
        tuple(name for name in names["output"] if name.endswith((".P", ".Q", ".R")) and not name.startswith("venous.")),
        {name: _start(variables[name]) for name in (*names["input"], *names["parameter"])},
    )


def _start(variable: ScalarVariable) -> float | str:
    if variable.type != "Enumeration":
        return float(variable.start)
    return next(str(item.name) for item in variable.declaredType.items if item.value == variable.start)


def steps_per_beat(fmu: FMU, T: float) -> int:
    """Internal steps of a beat: a whole number, each at most the FMU's dt (plus the round-off of a period)."""
    return max(8, int(np.ceil(T / fmu.dt - 1e-3)))


def periodic_answer(
    fmu: FMU,
    driver: str,
    beat: Array,
    T: float,
    start_values: Mapping[str, float | str],
    beats: int | None = None,
) -> Answer:
    """Drive the FMU with a periodic beat until its response is periodic.

    driver : an input. beat : (N,) [SI], its samples at j T/N, Fourier-interpolated. The internal step is T over a
    whole number, so that beats fall on the grid. beats : run exactly this number from rest; otherwise 5 to 60, until
    two agree to 1e-4. If the inflow drives it, it starts near the periodic state if the FMU can, at the phase of the
    network's own pulse; else at rest, at a pressure near the mean one, where the flow is least, because such a run
    begins with a jump to that flow.
    Raises RunFailed with the FMU's sentence, HostDied if it ended the process that ran it.
    """
    n = steps_per_beat(fmu, T)

    def run_from(first: int, m: int, starts: Mapping[str, float | str]) -> dict[str, Array]:
        values = {**start_values, "solver.dt": T / n, **starts}
        table = _run(fmu, driver, np.roll(beat, -first), T / n, n, m, values)
        return {name: shift(x, first / len(beat)) for name, x in table.items()} if first else table

    first = least = 0
    if beats is None and driver == INFLOW:
        network = read_network(Path(fmu.path))
        if not network.sources:  # tables begin with the beat
            first, least = _in_phase(beat, network), int(np.argmin(np.abs(beat)))
        level = float(start_values.get(_P_0, fmu.starts.get(_P_0, 0.0)))
        for start in (_Periodic(float(beat.mean()), T, first), _Level(level, least)):
            if {*start.values(0.0)} <= {*fmu.parameters}:
                with suppress(RunFailed):  # without a steady state at that mean flow, or that FMU's own alone
                    return _from(start, partial(run_from, start.first))
    for m in (beats,) if beats else BEATS:
        answer = _answer(run_from(least, m, {}))
        if answer.change <= PERIODIC:
            break
    return answer


def _in_phase(beat: Array, network: Network) -> int:
    """The sample of a beat (N,) at which it is most like the network's own pulse, which begins there."""
    pulse = network.inlet.Q(network.inlet.T / len(beat) * np.arange(len(beat)))
    return int(np.argmax(np.fft.irfft(np.fft.rfft(beat) * np.fft.rfft(pulse).conj(), len(beat))))


@dataclass(frozen=True)
class _Periodic:
    """Start from network.start = periodic, the beats of the network's own pulse, by its mean flow x [m³/s]."""

    x: float
    T: float
    first: int

    def values(self, x: float) -> dict[str, float | str]:
        return dict(zip(_START, ("periodic", x, self.T), strict=True))

    def per_pressure(self, x: float, P: float) -> float:
        """dx/dP of the mean pressure P [Pa] at which the run starts: P ~ Q."""
        return x / (P or 1.0)

    def within(self, x: float, P: float, shots: int) -> float:
        span = (0.5 if shots == 1 else 1.0) * abs(self.x)
        return float(np.clip(x, self.x - span, self.x + span))


@dataclass(frozen=True)
class _Level:
    """Start at rest, by the common pressure x [Pa]."""

    x: float
    first: int

    def values(self, x: float) -> dict[str, float | str]:
        return {_P_0: x}

    def per_pressure(self, x: float, P: float) -> float:
        return 1.0

    def within(self, x: float, P: float, shots: int) -> float:
        return float(np.clip(x, P - abs(P), P + abs(P)))


def _from(start: _Periodic | _Level, run: Callable[[int, Mapping[str, float | str]], dict[str, Array]]) -> Answer:
    """The response from a start with one number x.

    Windkessels fill slowly to the mean of the drive, which is not that of the start. The secant method therefore
    corrects x until the mean pressure does not drift between the last two beats of the shortest run, D(x) = 0. The
    drive of the FMU does not change.
    """
    x, shots = start.x, list[tuple[float, float]]()
    for m in (*BEATS[:1] * _SHOTS, *BEATS[1:]):
        table = run(m, start.values(x))
        answer = _answer(table)
        if answer.change <= PERIODIC:
            break
        x = _corrected(start, table, x, shots)
    return answer


def _corrected(
    start: _Periodic | _Level, table: Mapping[str, Array], x: float, shots: list[tuple[float, float]]
) -> float:
    """The next x after a run from x, which is appended to the ``shots`` (x, D).

    The distance of the mean pressure P in beat m from its limit is λ^m e_0, so λ is the ratio of two drifts. After the
    first run the last drift gives e_0, and with dx/dP the change of x.
    """
    P = np.mean([x.mean(axis=1) for name, x in table.items() if name.endswith(".P")], axis=0)[: BEATS[0]]
    before, drift = np.diff(P)[-2:]
    if shots:
        x_0, drift_0 = shots[-1]
        change = 0.0 if drift == drift_0 else -drift * (x - x_0) / (drift - drift_0)
    else:
        ratio = float(np.clip(drift / before if before else 0.0, *_SLOW))
        change = start.per_pressure(x, P[-1]) * drift / (1.0 - ratio) / ratio ** (len(P) - 1)
    shots.append((x, float(drift)))
    return start.within(x + change, float(P[-1]), len(shots))


def _answer(table: Mapping[str, Array]) -> Answer:
    """The last beat of a run, outputs (beats, n) by name, and its change from the one before."""
    before, last = (np.column_stack([x[beat] for x in table.values()]) for beat in (-2, -1))
    values = {name: x[-1] for name, x in table.items()}
    return Answer(values, len(next(iter(table.values()))), change_of(last, before, tuple(table)))


def takes(fmu: FMU, starts: Mapping[str, float | str]) -> bool:
    """True if an FMU with the compiled engine can be initialised with these start values."""
    try:
        _stepped(fmu.path, starts, {INFLOW: 0.0}, INFLOW, [], 1.0, ())
    except RunFailed:
        return False
    return True


def _run(
    fmu: FMU, driver: str, beat: Array, h: float, n: int, beats: int, starts: Mapping[str, float | str]
) -> dict[str, Array]:
    """All beats of a run : (beats, n) of every output. Raises RunFailed, or HostDied if a process of its own died.

    During each step the inflow is linear; another input has its mid-step value.
    """
    parts = 1 if driver == INFLOW else 2
    values = np.tile(interpolated(beat, parts * n), beats)
    values = np.append(values, values[0])
    if not fmu.native:
        return _run_apart(fmu, driver, values, h / parts, beats, n, starts)
    first = {INFLOW: 0.0, driver: float(values[0])}
    drives = values[1::parts].tolist()
    table = _stepped(fmu.path, {"inlet.interpolation": "linear", **starts}, first, driver, drives, h, fmu.outputs)
    return {name: column[:-1].reshape(beats, n) for name, column in zip(fmu.outputs, table.T, strict=True)}


def _run_apart(
    fmu: FMU, driver: str, values: Array, part: float, beats: int, n: int, starts: Mapping[str, float | str]
) -> dict[str, Array]:
    """The same in a new process, which has its input and gives its result as files. values : at multiples of ``part``,
    an input other than the inflow at every half step, which represents it exactly."""
    h = part if driver == INFLOW else 2.0 * part
    time = np.arange(len(values)) * part
    stop = beats * n * h
    time[-1] = max(time[-1], stop)
    with TemporaryDirectory(prefix="check_", ignore_cleanup_errors=True) as folder:
        inputs, start_values, result = (Path(folder) / name for name in ("inputs.csv", "starts.json", "result.csv"))
        rows = [f"{t!r},{value!r}" for t, value in zip(time.tolist(), values.tolist(), strict=True)]
        inputs.write_text("\n".join([f"time,{driver}", *rows, ""]), encoding="utf-8")
        start_values.write_text(json.dumps(dict(starts)), encoding="utf-8")
        options = {"--inputs": inputs, "--start-values": start_values, "--out": result}
        line = ["arterial_fmu.cli.run", os.path.abspath(fmu.path), "--quiet"]
        line += [part for option, path in options.items() for part in (option, os.fspath(path))]
        line += ["--stop-time", f"{stop!r} s", "--step", f"{h!r} s"]
        code, message = run_module(*line)
        if code != 0:
            if code == ExitCode.BAD_INPUT and message:
                raise RunFailed(message.replace(os.path.abspath(fmu.path), Path(fmu.path).name))
            raise HostDied(fmu.path, code, message)  # it tells a command with the path
        with result.open(encoding="utf-8") as file:
            names = [title.split(" [")[0] for title in file.readline().split(",")]
            table = np.loadtxt(file, delimiter=",", ndmin=2)
    if len(table) != beats * n + 1 or abs(table[-1, 0] - stop) > 1e-9 * stop:
        raise RunFailed(f"{Path(fmu.path).name}: the run stopped at {table[-1, 0]:g} s instead of {stop:g} s.")
    columns = {name: table[:, names.index(name)] for name in fmu.outputs}
    return {name: column[:-1].reshape(beats, n) for name, column in columns.items()}


def run_module(*line: str) -> tuple[int, str]:
    """Run ``python -m line`` in a new process: its exit code, and its last error sentence ("" if none)."""
    command, environment = [sys.executable, "-m", *line], {**os.environ, **ENVIRONMENT}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    lines = [text.strip() for text in done.stderr.splitlines() if text.strip()]
    return done.returncode, lines[-1].removeprefix("Error: ") if lines else ""


# --- in this process -------------------------------------------------------------------------------------------------


def _stepped(
    path: str | os.PathLike[str],
    starts: Mapping[str, float | str],
    first: Mapping[str, float],
    driver: str,
    drives: Sequence[float],
    h: float,
    outputs: Sequence[str],
) -> Array:
    """Outputs at times 0, h, … n h : (n + 1, n_outputs) [SI] of an FMU for FMI 2.0.

    starts : start values, for an Enumeration the name of an item. first : inputs at time 0. driver, drives : an input
    and its value (n,) during each step; the inflow is interpolated, so its value is that of the step's end.
    Raises RunFailed if a call fails.
    """
    description = fmpy.read_model_description(os.fspath(path))
    variables = {variable.name: variable for variable in description.modelVariables}
    messages: list[str] = []

    def log(_environment: Any, _name: bytes, status: int, _category: bytes, text: bytes) -> None:
        if status > fmi2Warning:
            messages.append(text.decode("utf-8", "replace"))

    with TemporaryDirectory(prefix="check_", ignore_cleanup_errors=True) as folder:
        fmpy.extract(os.fspath(path), folder)
        slave = None
        try:
            slave = fmpy.instantiate_fmu(folder, description, "CoSimulation", logger=log, debug_logging=True)
            slave.setupExperiment(startTime=0.0)
            for name, value in starts.items():
                _put(slave, variables[name], value)
            slave.setReal([variables[name].valueReference for name in first], list(first.values()))
            slave.enterInitializationMode()
            slave.exitInitializationMode()
            return _steps(slave, variables[driver], drives, h, [variables[name].valueReference for name in outputs])
        except FMICallException as error:
            raise RunFailed(f"{Path(path).name}: {' '.join(messages) or error}") from None
        finally:
            if slave is not None:
                slave.freeInstance()


def _put(slave: Any, variable: ScalarVariable, value: float | str) -> None:
    if variable.type == "Enumeration":
        (number,) = (int(item.value) for item in variable.declaredType.items if item.name == value)
        slave.setInteger([variable.valueReference], [number])
    else:
        slave.setReal([variable.valueReference], [float(value)])


def _steps(slave: Any, driver: ScalarVariable, drives: Sequence[float], h: float, outputs: Sequence[int]) -> Array:
    table = np.empty((len(drives) + 1, len(outputs)))
    table[0] = slave.getReal(outputs)
    for i, value in enumerate(drives):
        slave.setReal([driver.valueReference], [value])
        slave.doStep(i * h, h)
        table[i + 1] = slave.getReal(outputs)
    slave.terminate()
    return table
