"""The models of a study: a network or an FMU, for several parameter sets at once, and its inflow."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fitting.records.alignment.align import align
from fitting.records.channels.inflow import Inflow, inflow
from fitting.records.plausible import Artery, arteries, check_plausible
from fitting.records.read.columns import Reading
from fitting.records.read.record import Array, read_record
from solver import Network, Settings, repeating_beat
from solver.errors import InputError
from solver.network.files import dumps, find_network, parse_quantity, read_network
from solver.quantities.quantity import Quantity
from solver.quantities.text import typed_quantity
from solver.quantities.units import INFLOW
from solver.scheme.model import build
from solver.simulate import BROKEN

from .varied import Varied

Beats = Mapping[str, Array]  # by channel [SI], (N,) or (n, N): sample j at time j T/N

MAX_BEATS = 30
ELEMENT = 0.05  # m, longest element if walls damp little
_LONGER = 40.0  # m/s: with viscous walls, elements as much longer as steps; errors of both fall together
_LONGEST = 0.1  # m
_NETWORKS = ("", ".toml", ".fmu")  # suffixes; any other is that of a record


@dataclass(frozen=True)
class NetworkModel:
    """A network, solved in steps of ``settings`` until beats repeat to ``tolerance``.

    flow : the drive of the inlet, if it is not the network's own. longer : elements [m] to use where walls allow it
    (:meth:`resolving`). Its methods are those of any model of a study.
    """

    network: Network
    settings: Settings
    tolerance: float
    flow: Inflow | None = None
    longer: float = 0.0

    @property
    def name(self) -> str:
        return self.network.name

    @property
    def known(self) -> Mapping[str, Quantity]:
        """Its parameters."""
        return self.network.parameter_quantities()

    @property
    def nominal(self) -> Mapping[str, float]:
        """Their values [SI]."""
        return self.network.parameters()

    @property
    def channels(self) -> tuple[str, ...]:
        """Its outputs, by the names of the FMU's outputs."""
        return tuple(self.network.output_units())

    @property
    def batch(self) -> int:
        """The best number of parameter sets per batch.

        64 for the sheep: twice as many cost the same per set, half as many a quarter more (measured).
        """
        return max(8, min(64, 2048 // len(self.network.segments)))

    @property
    def identity(self) -> Mapping[str, Any]:
        """All that its results depend on, as plain data."""
        s = self.settings
        return {
            "network": dumps(self.network),
            "inflow": None if self.flow is None else _digest(self.flow.X),
            "T": self.T,
            "settings": [s.dt, s.element_length, s.degree, s.tolerance],
            "tolerance": self.tolerance,
        }

    @property
    def T(self) -> float:
        """The period [s]."""
        return self.network.inlet.T if self.flow is None else self.flow.T

    def at(self, sites: Sequence[str]) -> NetworkModel:
        """The same model with outputs at some sites only."""
        kept = tuple(site for site in self.network.sites if site.name in sites)
        return replace(self, network=replace(self.network, sites=kept))

    def resolving(self, varied: Sequence[Varied]) -> NetworkModel:
        """The same model with the longer elements, if the viscosity of all walls damps what these do not resolve, at
        the values of the file and at both ends of each range."""
        if self.longer <= self.settings.element_length:
            return self
        settings, ends = replace(self.settings, element_length=self.longer), 1 + 2 * len(varied)
        parameters = {name: np.full(ends, self.nominal[name]) for each in varied for name in each.nominal}
        for i, each in enumerate(varied):
            for name, pair in each.values(np.array([each.low, each.high])).items():
                parameters[name][1 + 2 * i : 3 + 2 * i] = pair
        try:
            allowed = build(self.network, parameters, settings).damps_itself
        except InputError:  # the sets at this end will say so
            allowed = False
        return replace(self, settings=settings) if allowed else self

    def finer(self) -> NetworkModel:
        """The same model with half the step and half the element length."""
        s = self.settings
        settings = replace(s, dt=s.dt / 2.0, element_length=s.element_length / 2.0, tolerance=s.tolerance / 10.0)
        return replace(self, settings=settings, tolerance=self.tolerance / 10.0)

    def run(self, parameters: Mapping[str, Array]) -> list[Beats | str]:
        """The periodic beat of every parameter set, or the sentence with the reason of its failure.

        All at once; after a failure in halves, until the failing set is alone.
        """
        n = len(next(iter(parameters.values())))
        try:
            beat = repeating_beat(
                self.network, self.flow, self.T, parameters=parameters, settings=self.settings,
                tolerance=self.tolerance, resolved=self.tolerance, max_beats=MAX_BEATS, backend="auto",
            )  # fmt: skip
        except BROKEN as error:
            if n == 1:
                return [str(error)]
            parts = ({name: x[part] for name, x in parameters.items()} for part in (slice(n // 2), slice(n // 2, n)))
            return [answer for part in parts for answer in self.run(part)]
        return [{name: beat[name][i, :-1] for name in self.channels} for i in range(n)]


@dataclass(frozen=True)
class FMUModel:
    """An FMU, run by FMPy in a new process for every parameter set, driven by a beat (N,) [m³/s] of T [s]."""

    path: str
    sha256: str
    beat: tuple[float, ...]
    T: float
    known: Mapping[str, Quantity] = field(repr=False)
    nominal: Mapping[str, float] = field(repr=False)

    @cached_property
    def _fmu(self) -> Any:
        from fitting.check.fmu_run import read_fmu

        return read_fmu(self.path)

    @property
    def name(self) -> str:
        return str(self._fmu.name)

    @property
    def channels(self) -> tuple[str, ...]:
        return tuple(self._fmu.outputs)

    @property
    def batch(self) -> int:
        return 4  # a process each: they share nothing

    @property
    def tolerance(self) -> float:
        """To which its beats repeat."""
        from fitting.check.fmu_run import PERIODIC

        return PERIODIC

    @property
    def identity(self) -> Mapping[str, Any]:
        return {"fmu": self.sha256, "inflow": _digest(np.array(self.beat)), "T": self.T}

    def finer(self) -> None:
        return None

    def run(self, parameters: Mapping[str, Array]) -> list[Beats | str]:
        from fitting.check.fmu_run import RunFailed, periodic_answer
        from solver.io.exit_codes import HostDied

        answers: list[Beats | str] = []
        for values in zip(*parameters.values(), strict=True):
            starts = dict(zip(parameters, map(float, values), strict=True))
            try:
                answers.append(periodic_answer(self._fmu, INFLOW, np.array(self.beat), self.T, starts).values)
            except (RunFailed, HostDied) as error:
                answers.append(str(error))
        return answers


StudyModel = NetworkModel | FMUModel


def read_model(
    source: str,
    driven_by: str | None,
    dt: str,
    element_length: str | None,
    tolerance: float,
    how: Reading | None = None,
    as_measured: bool = False,
) -> StudyModel:
    """The model of a bundled name, a network file or an FMU.

    driven_by : the source of the inflow, a network or a record with inlet.Q, read as ``how`` says. An FMU needs it.
    as_measured : whether a flow is taken that no artery of the network's size has.
    element_length : None for 5 cm, or up to 10 cm where viscous walls allow it.
    Raises ValueError, one sentence.
    """
    seconds = parse_quantity(dt, "s", "--dt")
    if not 0.0 < tolerance <= 0.1:
        raise InputError(f"--tolerance = {tolerance:g}: must be above 0, and 0.1 at most.")
    if source.lower().endswith(".fmu"):
        return _fmu_model(source, driven_by, how, as_measured)
    network = read_network(find_network(source))
    longest = ELEMENT if element_length is None else typed_quantity(element_length, "m", "--element-length")
    longer = min(_LONGEST, _LONGER * seconds) if element_length is None else 0.0
    settings = Settings(seconds, longest, tolerance=min(Settings().tolerance, 0.3 * tolerance))
    if driven_by is None:
        if any(inlet.given is None for inlet in network.inlets):
            raise InputError(f"{source}: the drive of its inlet is unknown; add a curve to the network file.")
        return NetworkModel(network, settings, tolerance, None, longer)
    if len(network.inlets) > 1 or network.inlet.causality != "flow":
        raise InputError(f"--inflow {driven_by}: {source} is not driven by one flow; leave --inflow out.")
    known = {} if as_measured else arteries(network)
    return NetworkModel(network, settings, tolerance, _flow(driven_by, seconds, how, known, network), longer)


def _fmu_model(path: str, driven_by: str | None, how: Reading | None, as_measured: bool) -> FMUModel:
    import fmpy

    from fitting.check.fmu_run import read_fmu

    fmu = read_fmu(path)
    if driven_by is None:
        raise InputError(
            f"{path}: an FMU is driven by an inflow; add --inflow with a network, such as sheep, or a record with "
            f"{INFLOW}."
        )
    known, nominal = {}, {}
    for variable in fmpy.read_model_description(path).modelVariables:
        number = variable.name in fmu.parameters and variable.type in ("Real", "Float64")  # of FMI 2.0, of FMI 3.0
        if number and not variable.name.startswith("solver."):
            low, high = (float(end) if end else sign * np.inf for end, sign in ((variable.min, -1), (variable.max, 1)))
            unit = variable.unit or "1"
            description, display = variable.description or variable.name, variable.displayUnit
            known[variable.name] = Quantity(unit, description, low, high, display=display)
            nominal[variable.name] = float(variable.start)
    radii = [] if as_measured else [value for name, value in nominal.items() if name.endswith(".R0")]
    # an FMU does not say which vessel has the inlet: none is wider than the widest
    flow = _flow(driven_by, fmu.dt, how, {"inlet": Artery(max(radii))} if radii else {})
    n = 2 * flow.X.shape[-1]
    beat = flow(np.arange(n) * (flow.T / n))
    digest = hashlib.sha256(Path(path).read_bytes()).hexdigest()
    return FMUModel(path, digest, tuple(beat.tolist()), flow.T, known, nominal)


def _flow(
    source: str, dt: float, how: Reading | None, known: Mapping[str, Artery], network: Network | None = None
) -> Inflow:
    """The inflow of a network, or the mean beat of a record, up to the frequencies that steps of dt [s] resolve.
    how : to read the record. known : arteries whose size its flow must suit. network : has the filter of its meter."""
    if Path(source).suffix.lower() in _NETWORKS:
        inlet = read_network(find_network(source)).inlet
        if inlet.causality != "flow":
            raise InputError(f"--inflow {source}: a pressure is given at its inlet; give a network with a flow.")
        n = 2 * max(4, int(inlet.T / (2.0 * dt)))
        X = np.fft.rfft(inlet.Q(np.arange(n) * (inlet.T / n)), norm="forward")
        X[-1] *= 0.5
        return Inflow(inlet.T, X, np.ones(len(X), bool))
    record = read_record(source, how)
    record.require((INFLOW,))
    check_plausible(replace(record, channels={INFLOW: record.channels[INFLOW]}), known)
    return inflow(align(record), dt, network)


def _digest(numbers: Array) -> str:
    return hashlib.sha256(np.ascontiguousarray(numbers).tobytes()).hexdigest()
