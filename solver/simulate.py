"""Run a network for a given duration, or until its beats repeat."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .errors import InputError, NonPhysicalState
from .network.coefficients import Parameters
from .network.description import Network
from .network.inflow import Drives, Inflows, drives_of
from .periodic.mixing import Beats, fills_slowly
from .quantities.units import SIGNAL_UNITS
from .scheme.model import Settings
from .scheme.outputs import Reporter
from .scheme.sdirk import INFLOW_TIMES
from .schemes import AnySettings, Scheme, scheme_of
from .tracing.native import Backend
from .waveforms import End, Waveforms

Array = np.ndarray
Progress = Callable[[float, str], None]

STARTS = ("rest", "periodic")

_STEADY = 1e-4  # of an output's magnitude: a smaller pulse counts as steady when beats are compared
_LARGEST_TABLE = 4e9  # bytes of one run's or one beat's outputs
_NEARER = 0.5  # of the smallest change so far: accelerated beats without this reduction get more iterations
_PARTS = 16  # of a beat, after which its repetition is tested
_FINEST = 1e-12  # smallest tolerance of the iterations


class NotPeriodic(ArithmeticError):
    """The beats did not repeat within the allowed number; ``beats`` is their number, ``change`` the last change."""

    def __init__(self, beats: int, change: float, tolerance: float) -> None:
        self.beats, self.change = beats, change
        super().__init__(
            f"after {beats} beats the last differs by {change:.2g} from the one before (tolerance {tolerance:g}); "
            "allow more beats, start nearer to the mean pressure (network.P_0) or loosen the tolerance."
        )


BROKEN = (NonPhysicalState, NotPeriodic, InputError, np.linalg.LinAlgError)  # possible errors of a parameter set


def simulate(
    network: Network,
    inflow: Inflows | None = None,
    duration: float | None = None,
    *,
    parameters: Parameters | None = None,
    settings: AnySettings | None = None,
    scheme: str = "staggered",
    start: str = "rest",
    progress: Progress | None = None,
    backend: str = "auto",
) -> Waveforms:
    """Run from rest under P_0 for ``duration`` [s] (default one period of the inlet).

    inflow : Q(t) [m³/s] for an array of times (n,), as (n,) or for each of a batch as (n, B); default the network's
    inlet; for several inlets by driving variable, {"inlet.Q": …, "LSA.inlet.Q": …}. parameters : values by FMU variable
    name, numbers or arrays of B numbers (a batch). The time grid is n·dt; it ends at or just after the duration.
    start : "rest", or "periodic": near the periodic state under this inflow at the inlet's period
    (:mod:`~solver.periodic.start`).
    A batch shares one mesh, made for the longest of each segment, and stops at the first member that fails.
    scheme : "staggered", or "muscl", the paper's finite volumes (:mod:`~solver.muscl`), with its settings.
    backend : "auto", the compiled engine (:mod:`~solver.tracing.native`) if it is available and supports this run, else
    NumPy, which computes the same steps; "numpy"; "native", which raises an error without the engine.
    Raises ValueError for bad parameters or inflow, NonPhysicalState if the solution fails.
    """
    check_network(network)
    made, settings = scheme_of(scheme, settings)
    duration = network.inlet.T if duration is None else duration
    if not (isinstance(duration, (int, float, np.number)) and math.isfinite(duration) and duration > 0):
        raise InputError(f"duration = {duration!r} s: must be a positive, finite number.")
    if start not in STARTS:
        raise InputError(
            f"start = {repr(start)[:40]}: must be {' or '.join(map(repr, STARTS))}; an earlier result is a start of "
            "simulate_periodic."
        )
    run = _run(network, inflow, parameters, made, settings, settings.dt, backend)
    n = max(1, math.ceil(duration / settings.dt - 1e-9))
    table, state = run.table(run.begin(start, network.inlet.T), n, progress, "simulating")
    return run.waveforms(table, duration / network.inlet.T, math.nan, state)


def simulate_periodic(
    network: Network,
    inflow: Inflows | None = None,
    period: float | None = None,
    *,
    parameters: Parameters | None = None,
    settings: AnySettings | None = None,
    scheme: str = "staggered",
    tolerance: float = 1e-5,
    max_beats: int = 100,
    start: Waveforms | str | None = None,
    accelerate: bool = True,
    progress: Progress | None = None,
    backend: str = "auto",
) -> Waveforms:
    """Run beats until every output repeats: relative L2 change from one beat to the next <= ``tolerance``.

    Pressures and radii are compared relative to their mean-removed norm, flows to their norm. The result is the last
    beat, both ends included, with time from 0. The step is the period over a whole number, at most settings.dt.
    start : "rest"; "periodic", near the result (:mod:`~solver.periodic.start`); or an earlier result, possibly with
    other parameters, whose last state is the start: it saves beats if little has changed; the result of one parameter
    set can start a batch. Default: rest, or periodic if that state exists and the arteries fill slowly.
    accelerate : whether slow pressures are extrapolated from beat to beat (:mod:`~solver.periodic.mixing`), and the
    default start may be the periodic one. In either case the result repeats the beat before.
    Raises ValueError, NonPhysicalState as :func:`simulate`, NotPeriodic after ``max_beats``, and ValueError if
    ``start`` has another mesh, step or batch.
    """
    run, n = _periodic_run(network, inflow, period, parameters, settings, tolerance, max_beats, scheme, backend)
    accelerate = accelerate and run.scheme.accelerates
    state, resort = run.begin_beats(start, n * run.dt, accelerate)
    return _until_repeated(run, n, state, tolerance, max_beats, progress, resort=resort, accelerate=accelerate)


def repeating_beat(
    network: Network, inflow: Inflows | None = None, period: float | None = None, *,
    parameters: Parameters | None = None, settings: Settings | None = None,
    tolerance: float = 1e-5, resolved: float = 0.0, max_beats: int = 100, progress: Progress | None = None,
    backend: str = "auto",
) -> Waveforms:  # fmt: skip
    """The beat of :func:`simulate_periodic` in a third of its time, for studies with thousands of beats.

    If harmonics suffice, :func:`~solver.harmonics.beat_harmonics` is faster and needs no time steps.

    The run starts near the periodic state, or at rest if there is none, and continues in sixteenths of a beat until the
    next beat would differ by <= ``tolerance`` (:func:`next_change`): transients decay within a beat, so the beat is
    equally near to the periodic one.
    resolved : a difference that suffices after two beats; steps solved to settings.tolerance may not repeat better than
    to a few times that. If a beat does not halve the difference, the run continues as simulate_periodic.
    Arguments, result and errors as there; ``change`` is that difference.
    """
    run, n = _periodic_run(network, inflow, period, parameters, settings, tolerance, max_beats, backend=backend)
    state, parts = run.near(n * run.dt, tolerance), min(_PARTS, n)
    table, change, done, least = run.report(state)[None], math.inf, 0, math.inf
    for part in range(parts + 2, parts * max_beats + 1):
        more, state = run.table(state, part * n // parts - done, progress, f"beat {1 + (part - 1) // parts}")
        table, done = np.concatenate([table, more[1:]])[-n - 2 * (n // parts) - 1 :], part * n // parts
        change = next_change(table, n, n // parts, run.report.names)
        if change <= (tolerance if part <= 2 * parts else max(tolerance, resolved)):
            beat = np.roll(table[-n:], done, axis=0)  # the last period's end is its start
            return run.waveforms(np.concatenate([beat[-1:], beat]), done / n, change, state, resumable=False)
        if part % parts == 0:
            if change > _NEARER * least:
                break
            least = change
    table = table[-n - 1 :]
    last = done // n, table, gap_of(table, run.report.names)
    return _until_repeated(run, n, state, max(tolerance, resolved), max_beats, progress, last=last)


def _until_repeated(
    run: _Run, n: int, state: Any, tolerance: float, max_beats: int, progress: Progress | None, *,
    resort: Any = None, accelerate: bool = True, last: tuple[int, Array | None, float] = (0, None, math.inf),
) -> Waveforms:  # fmt: skip
    """The first beat of n steps that repeats the one before.

    resort : an alternative start if the first beats fail. last : the number of beats until ``state``, the table of the
    last one, and the difference between its end and its start.
    """
    done, before, gap = last
    change, beats = math.inf, Beats(run.model.mesh.topology.outlets)
    least, nearer = math.inf, _NEARER if accelerate else 1.0
    for beat in range(done + 1, max_beats + 1):
        label = f"beat {beat}" + ("" if before is None or not math.isfinite(change) else f", change {change:.1e}")
        begun = state
        try:
            table, state = run.table(begun, n, progress, label)
        except NonPhysicalState:
            if resort is None:
                raise
            state, resort, beats = resort, None, Beats(beats.outlets)
            continue
        if before is not None:
            change = change_of(table, before, run.report.names)
            if change <= tolerance:
                return run.waveforms(table, beat, change, state)
            if change >= nearer * least:
                run = run.iterated_further(tolerance)
            least = min(change, least)
        before, resort, gap = table, None, gap_of(table, run.report.names)
        beats = beats.followed(begun, state, gap)
        two_left = beat + 2 <= max_beats  # an extrapolated beat needs two more for the comparison
        mixed = beats.mixed() if accelerate and gap > tolerance and two_left else None
        if mixed is not None:
            state, before, change, resort = mixed, None, math.inf, state
    # without an earlier beat, compare the end of the last one with its start
    raise NotPeriodic(max_beats, change if math.isfinite(change) else gap, tolerance)


def _periodic_run(
    network: Network, inflow: Inflows | None, period: float | None, parameters: Parameters | None,
    settings: AnySettings | None, tolerance: float, max_beats: int, scheme: str = "staggered", backend: str = "auto",
) -> tuple[_Run, int]:  # fmt: skip
    """The run for the periodic beats, and the number of steps per beat."""
    check_network(network)
    made, settings = scheme_of(scheme, settings)
    period = network.inlet.T if period is None else period
    if not (isinstance(period, (int, float, np.number)) and math.isfinite(period) and period >= settings.dt):
        raise InputError(
            f"period = {period!r} s: must be a finite number of at least one time step ({settings.dt:g} s)."
        )
    if not (isinstance(tolerance, (int, float, np.number)) and tolerance > 0.0):
        raise InputError(f"tolerance = {tolerance!r} must be a positive number.")
    if not (isinstance(max_beats, (int, np.integer)) and max_beats >= 2):
        raise InputError(f"max_beats = {max_beats!r} must be a whole number of at least 2: beats are compared.")
    n = math.ceil(period / settings.dt - 1e-9)
    return _run(network, inflow, parameters, made, settings, period / n, backend), n


def check_network(network: Any) -> None:
    """Raise ValueError unless it is a Network."""
    if not isinstance(network, Network):
        raise InputError(f"network = {network!r}: must be a Network; load() makes one of a file or of a name.")


def _run(
    network: Network, inflow: Inflows | None, parameters: Parameters | None,
    scheme: Scheme, settings: AnySettings, dt: float, backend: str,
) -> _Run:  # fmt: skip
    model = scheme.build(network, parameters, settings)
    drives = drives_of(network, inflow, model.coefficients.B)
    return _Run(scheme, model, scheme.reporter(model), drives, dt, Backend(backend, model, dt))


@dataclass(frozen=True)
class _Run:
    """A model under inflows by name, in steps of dt [s]."""

    scheme: Scheme
    model: Any
    report: Reporter[Any]
    drives: Drives
    dt: float
    backend: Backend

    def begin(self, start: Waveforms | str | None, period: float, tolerance: float = 0.0) -> Any:
        """The start state: rest, near the periodic one for beats of a tolerance, or the end of another run."""
        if start is None or start == "rest":
            return self.scheme.initial_state(self.model)
        if start == "periodic":
            backend = "auto" if self.backend.engine else "numpy"
            return self.scheme.periodic_state(
                self.model, self.drives, period, dt=self.dt, backend=backend, tolerance=tolerance
            )
        if not isinstance(start, Waveforms):
            raise InputError(f"start = {start!r}: must be {' or '.join(map(repr, STARTS))} or an earlier result.")
        if start.end is None:
            raise InputError("start: this result does not contain its last state; give one of simulate_periodic.")
        if not start.end.mesh.same_as(self.model.mesh) or abs(start.end.dt - self.dt) > 1e-12 * self.dt:
            raise InputError(
                f"start: it was run on another mesh or with another step than dt = {self.dt:g} s; "
                "keep period, settings, lengths and stenoses, or start from rest."
            )
        return replace(self.scheme.adopt(self.model, start.end.state), t=0.0, halved=0)

    def begin_beats(self, start: Waveforms | str | None, period: float, near: bool) -> tuple[Any, Any]:
        """The start state of the beats, and an alternative if it fails.

        The default is near the periodic state if the arteries fill slowly.
        """
        if start is None and near and fills_slowly(self.model, period):
            return self.near(period), self.begin("rest", period)
        return self.begin(start, period), None

    def iterated_further(self, tolerance: float) -> _Run:
        """The same with a tenth of the iteration tolerance, at most the given one, as residuals differ between
        beats."""
        settings = self.model.settings
        if not hasattr(settings, "tolerance"):
            return self
        finer = replace(settings, tolerance=max(0.1 * min(tolerance, settings.tolerance), _FINEST))
        model = replace(self.model, settings=finer)
        return replace(self, model=model, backend=self.backend.again(model))

    def near(self, period: float, tolerance: float = 0.0) -> Any:
        """A state near the periodic one, for beats of a tolerance, or rest."""
        try:
            return self.begin("periodic", period, tolerance)
        except InputError:  # no steady state under the mean inflow
            return self.begin("rest", period)

    def table(self, state: Any, n: int, progress: Progress | None, label: str) -> tuple[Array, Any]:
        """The outputs of n steps from a state, (n + 1, B, n_outputs), and the last state."""
        B, names = self.model.coefficients.B, self.report.names
        size = 8.0 * n * B * len(names)
        if size > _LARGEST_TABLE:
            raise InputError(
                f"{n * self.dt:g} s in steps of {self.dt:g} s: the outputs would take {size / 1e9:.0f} GB, more than "
                f"{_LARGEST_TABLE / 1e9:.0f} GB; run for a shorter time, with fewer sites or a smaller batch."
            )
        drive = self.drives((round(state.t / self.dt) + np.arange(n)[:, None] + INFLOW_TIMES) * self.dt)
        table = np.empty((n + 1, B, len(names)))
        table[0], done = self.report(state), 0
        every = max(1, n // 50) if progress else n
        for until in range(every, n + every, every):
            end = min(until, n)
            while done < end:
                many, state = self.backend.steps(state, drive[done:end], table[done + 1 : end + 1])
                if not many:
                    state, many = self.scheme.step(self.model, state, self.dt, drive[done]), 1
                    table[done + 1] = self.report(state)
                done += many
            if progress and done == until:
                progress(done / n, label)
        return table, state

    def waveforms(self, table: Array, beats: float, change: float, state: Any, resumable: bool = True) -> Waveforms:
        """The result of a table (n + 1, B, n_outputs) of the run until ``state``, in which it ends if ``resumable``."""
        end = End(state, self.model.mesh, self.dt) if resumable else None
        time = np.arange(len(table)) * self.dt
        since = 0.0 if end is None else (round(end.state.t / self.dt) - len(table) + 1) * self.dt
        values = {name: self.drives.values(name, since + time).T for name in self.drives.inflows}
        for i, name in enumerate(self.report.names):
            values[name] = table[:, :, i].T.copy() if self.model.coefficients.batched else table[:, 0, i].copy()
        units = {name: SIGNAL_UNITS[name[-1]] for name in self.drives.inflows}
        units |= dict(zip(self.report.names, self.report.units, strict=True))
        return Waveforms(time, values, units, beats, change, end, state.halved, self.backend.name)


def change_of(table: Array, before: Array, names: Sequence[str]) -> float:
    """Largest relative L2 difference of an output (n, …, n_names) from the beat before.

    Pressures and radii relative to their mean-removed norm, flows to their norm.
    """
    return _largest(np.linalg.norm(table - before, axis=0), table, names)


def next_change(table: Array, n: int, few: int, names: Sequence[str]) -> float:
    """Largest relative L2 difference of an output in the next beat from the last one, estimated from the last steps of
    a table (> n + 2 few, …, n_names).

    Their differences d_1, d_2 from the beat before, over ``few`` steps each, go on to decay: the sum of squares is
    d_2² (1 + r² + r⁴ + …) with r = d_2/d_1, 1 at most, over a beat.
    """
    off, last = table[-2 * few :] - table[-2 * few - n : -n], table[-n - 1 :]
    before, after = (_largest(np.linalg.norm(part, axis=0), last, names) for part in (off[:few], off[few:]))
    decay = min(1.0, after / before) if before > 0.0 else 1.0
    return after * math.sqrt(sum(decay ** (2 * i) for i in range(n // few)))


def gap_of(table: Array, names: Sequence[str]) -> float:
    """Largest difference between the end and the beginning of an output, relative to its root mean square as above."""
    return math.sqrt(len(table) - 1) * _largest(np.abs(table[-1] - table[0]), table, names)


def _largest(difference: Array, table: Array, names: Sequence[str]) -> float:
    """The largest of differences (…, n_names) over the norms of outputs (n, …, n_names)."""
    pulsatile = np.array([not name.endswith(".Q") for name in names])
    size = np.linalg.norm(table - np.where(pulsatile, table.mean(axis=0), 0.0), axis=0)
    # a nearly steady output (steady inflow, flow into a closed end) is compared with the largest of its kind
    whole = np.linalg.norm(table, axis=0)
    for kind in "PQR":
        same = np.array([name.endswith(f".{kind}") for name in names])
        if same.any():
            whole[..., same] = whole[..., same].max(axis=-1, keepdims=True)
    scale = np.maximum(size, _STEADY * whole)
    return float(np.max(np.divide(difference, scale, out=np.zeros_like(scale), where=scale > 0.0)))
