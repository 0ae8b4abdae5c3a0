"""An FMU from the outside: its description, and its periodic response to a periodic input.

Each run uses a new process, because a process that has run one FMU keeps its code.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
import numpy as np
from fmpy.model_description import ScalarVariable

from solver.errors import InputError
from solver.io.exit_codes import ExitCode
from solver.io.host_died import HostDied
from solver.network.description import Network
from solver.network.files import read_network
from solver.quantities.units import INFLOW
from solver.simulate import change_of

from ..parallel.threads import ENVIRONMENT
from ..records.channels.spectral import resample, shift

Array = np.ndarray

BEATS = (5, 10, 20, 40, 60)  # numbers of beats of successive runs, until the last two beats agree
PERIODIC = 1e-4  # largest relative change of an output between them
_SHOTS = 4  # runs with the fewest beats, to correct the start
_SLOW = 0.3, 0.99  # range of λ for slow filling, where more than 1e-3 remains after five beats
_START = ("network.start", "inlet.Q_mean", "inlet.T")


class RunFailed(RuntimeError):
    """The FMU did not reach its stop time; the message is the FMU's sentence."""


@dataclass(frozen=True)
class FMU:
    """The content of modelDescription.xml. inputs, parameters : names.

    starts : values of inputs and parameters; for an Enumeration the name of its item.
    outputs : names of pressures, flows and radii, without ports and volumes, which accumulate from beat to beat.
    """

    path: str
    name: str
    guid: str
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    outputs: tuple[str, ...]
    starts: Mapping[str, float | str]

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
    two agree to 1e-4. If the inflow drives it, it starts near the periodic state if there is one, at the phase of the
    network's own pulse; else where the flow is least, because a run from rest begins with a jump to that flow.
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
        if {*_START} <= {*fmu.parameters}:
            with suppress(RunFailed):  # without a steady state at that mean flow, start from rest
                return _from_periodic(partial(run_from, first), float(beat.mean()), T)
    for m in (beats,) if beats else BEATS:
        answer = _answer(run_from(least, m, {}))
        if answer.change <= PERIODIC:
            break
    return answer


def _in_phase(beat: Array, network: Network) -> int:
    """The sample of a beat (N,) at which it is most like the network's own pulse, which begins there."""
    pulse = network.inlet.Q(network.inlet.T / len(beat) * np.arange(len(beat)))
    return int(np.argmax(np.fft.irfft(np.fft.rfft(beat) * np.fft.rfft(pulse).conj(), len(beat))))


def _from_periodic(run: Callable[[int, Mapping[str, float | str]], dict[str, Array]], mean: float, T: float) -> Answer:
    """The response from network.start = periodic, the beats of the network's own pulse.

    Another pulse fills Windkessels to another mean, slowly. The secant method therefore corrects the mean Q of the
    start until the mean pressure does not drift between the last two beats of the shortest run, D(Q) = 0. The drive of
    the FMU does not change.
    """
    Q, shots = mean, list[tuple[float, float]]()
    for m in (*BEATS[:1] * _SHOTS, *BEATS[1:]):
        table = run(m, dict(zip(_START, ("periodic", Q, T), strict=True)))
        answer = _answer(table)
        if answer.change <= PERIODIC:
            break
        Q = _corrected(table, mean, Q, shots)
    return answer


def _corrected(table: Mapping[str, Array], mean: float, Q: float, shots: list[tuple[float, float]]) -> float:
    """The next Q after a run with start Q, which is appended to the ``shots`` (Q, D).

    The distance of the mean pressure P in beat m from its limit is λ^m e_0, so λ is the ratio of two drifts. After the
    first run the last drift gives e_0, and P ~ Q gives Q.
    """
    P = np.mean([x.mean(axis=1) for name, x in table.items() if name.endswith(".P")], axis=0)[: BEATS[0]]
    before, drift = np.diff(P)[-2:]
    if shots:
        (Q_0, drift_0), span = shots[-1], abs(mean)
        change = 0.0 if drift == drift_0 else -drift * (Q - Q_0) / (drift - drift_0)
    else:
        ratio, span = float(np.clip(drift / before if before else 0.0, *_SLOW)), 0.5 * abs(mean)
        change = Q / (P[-1] or 1.0) * drift / (1.0 - ratio) / ratio ** (len(P) - 1)
    shots.append((Q, float(drift)))
    return float(np.clip(Q + change, mean - span, mean + span))


def _answer(table: Mapping[str, Array]) -> Answer:
    """The last beat of a run, outputs (beats, n) by name, and its change from the one before."""
    before, last = (np.column_stack([x[beat] for x in table.values()]) for beat in (-2, -1))
    values = {name: x[-1] for name, x in table.items()}
    return Answer(values, len(next(iter(table.values()))), change_of(last, before, tuple(table)))


def fourier(beat: Array, M: int) -> Array:
    """The trigonometric interpolant of a beat (N,) at M equidistant phases: (M,), sampled without truncation."""
    every = -(-len(beat) // M)
    return resample(beat, every * M)[::every]


def _run(
    fmu: FMU, driver: str, beat: Array, h: float, n: int, beats: int, starts: Mapping[str, float | str]
) -> dict[str, Array]:
    """All beats of a run in a new process : (beats, n) of every output.

    Raises RunFailed, or HostDied if that process died.
    """
    # an input other than the inflow has its mid-step value during each step: half steps represent it exactly
    parts = 1 if driver == INFLOW else 2
    values = np.tile(fourier(beat, parts * n), beats)
    values = np.append(values, values[0])
    time = np.arange(len(values)) * (h / parts)
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
        code, said = run_module(*line)
        if code != 0:
            raise RunFailed(said) if code == ExitCode.BAD_INPUT and said else HostDied(fmu.path, code, said)
        with result.open(encoding="utf-8") as file:
            names = [title.split(" [")[0] for title in file.readline().split(",")]
            table = np.loadtxt(file, delimiter=",", ndmin=2)
    if len(table) != beats * n + 1 or abs(table[-1, 0] - stop) > 1e-9 * stop:
        raise RunFailed(f"{fmu.path}: the run stopped at {table[-1, 0]:g} s instead of {stop:g} s.")
    columns = {name: table[:, names.index(name)] for name in fmu.outputs}
    return {name: column[:-1].reshape(beats, n) for name, column in columns.items()}


def run_module(*line: str) -> tuple[int, str]:
    """Run ``python -m line`` in a new process: its exit code, and its last error sentence ("" if none)."""
    command, environment = [sys.executable, "-m", *line], {**os.environ, **ENVIRONMENT}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    said = [text.strip() for text in done.stderr.splitlines() if text.strip()]
    return done.returncode, said[-1].removeprefix("Error: ") if said else ""
