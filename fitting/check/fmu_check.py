"""Check of a parameter set: run the FMU with it, and compare with the record.

Network: the record's mean inflow drives the FMU until its beat repeats; the check compares all common channels. Bench:
there is no inflow; the measured pressure of one site drives the FMU of one short segment, and the check compares the
radius. The simulated beat has the record's phase because its drive has. Known filters of channels, from the FMU's
network file or the user, are removed from the drive (:mod:`fitting.records.channels.inflow`) and applied to the
simulated channels.

Residuals are *whitened*: the harmonics of the measured minus the simulated mean beat, over their standard deviation due
to noise. This includes the noise of the drive: a second run, with a slightly different beat, gives the FMU's response
to each of its harmonics. The top quarter of the harmonics is excluded, because a sampled beat does not determine the
drive there; the noise does not include the solver's own error.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.laws.catalogue import filtered, zero_of
from solver.network.description import Network
from solver.network.files import read_network
from solver.quantities.units import INFLOW

from ..inference.models.bench_network import own_values
from ..records.alignment.align import align
from ..records.alignment.beats import Beats
from ..records.channels.filters import with_filters
from ..records.channels.inflow import flowed, undoable
from ..records.channels.spectral import coefficients, interpolated
from ..records.plausible import Artery, check_plausible
from ..records.read.record import Array, Record
from ..records.recordings import sizes
from ..results.parameter_set import ParameterSet
from ..results.result_files import json_text
from .agreement import Agreement, LoopArea, Waveform, compare_channel, compare_loops, is_noisy
from .fmu_build import answering, fmu_of
from .fmu_run import FMU, PERIODIC, Answer, RunFailed, periodic_answer, read_fmu, steps_per_beat

Progress = Callable[[str], None]

_TRUSTED = 0.75  # of the Nyquist frequency
_NUDGE = 0.01  # of the driving beat's pulsatile standard deviation: the second run's difference
_LOUD, _WHITE = 5.0, 1.3  # limits of z of a harmonic and of the whitened RMS of a channel for agreement
ANOTHER = 3.0  # ratio of R0 or h: animals of a species differ by less, fits of one artery by far less
_SEED = 11  # phases of the nudge


@dataclass(frozen=True)
class CheckReport:
    """The result of :func:`check`. mode : "network" or "bench". waveforms : by channel, including the drive.

    sources : record, FMU and set. run : how the FMU was run. warnings : notes, one sentence each.
    """

    mode: str
    driver: str
    T: float
    channels: tuple[Agreement, ...]
    loops: tuple[LoopArea, ...]
    sources: Mapping[str, Any]
    run: Mapping[str, Any]
    warnings: tuple[str, ...]
    waveforms: Mapping[str, Waveform] = field(repr=False)

    @property
    def worst(self) -> Agreement:
        """The channel with the largest relative error."""
        return max(self.channels, key=lambda channel: channel.relative)

    @property
    def title(self) -> str:
        """One sentence: whether FMU and record agree to the noise, the worst channel, and the worst harmonic."""
        worst = self.worst
        norm = "norm" if worst.name.endswith(".Q") else "pulsatile norm"
        rms = {channel.name: channel.rmse for channel in self.channels}
        loud = {channel.name: channel.relative for channel in self.channels}
        part = 100.0 * worst.relative
        percent = f"{part:.0f} %" if part >= 10.0 else f"{part:.2g} %"
        text = f"worst channel {worst.name}: {percent} of its {norm} (rms {sizes(rms, loud)})"
        noisy = [channel for channel in self.channels if channel.worst_z is not None]
        if not noisy:
            return text
        loudest = max(noisy, key=lambda channel: channel.worst_z or 0.0)
        agrees = (loudest.worst_z or 0.0) < _LOUD and all((c.whitened or 0.0) < _WHITE for c in noisy)
        verdict = "agrees to the noise" if agrees else "differs by more than the noise"
        where = "mean" if loudest.worst_harmonic == 0 else f"harmonic {loudest.worst_harmonic}"
        return f"{verdict}; {text}; largest deviation {loudest.name}, {where}: z = {loudest.worst_z:.1f}"

    def to_json(self) -> str:
        """Everything but the waveforms."""
        data = {
            "title": self.title,
            "mode": self.mode,
            "driver": self.driver,
            "T": {"value": self.T, "unit": "s"},
            "channels": {channel.name: asdict(channel) for channel in self.channels},
            "loops": {loop.site: {**asdict(loop), "unit": "J/m"} for loop in self.loops},
            "warnings": self.warnings,
            "run": self.run,
            "sources": self.sources,
        }
        return json_text(data)


def check(
    parameters: ParameterSet,
    fmu: str | os.PathLike[str],
    record: Record,
    *,
    period: float | None = None,
    filters: Iterable[str] = (),
    as_measured: bool = False,
    backend: str = "auto",
    progress: Progress | None = None,
) -> CheckReport:
    """Run the FMU with the set as start values, driven by the record, and compare all common channels.

    fmu : an FMU, which is run as it is, or a network file or a bundled network, of which an FMU is built with the
    ``backend`` (:func:`~fitting.check.fmu_build.build_fmu`).
    period : of the beat [s], by default found. filters : of channels, "inlet.Q=lowpass 10 Hz". as_measured : accept
    values that no artery has.
    progress : called with the current task.
    Raises ValueError, one sentence, if set, FMU and record do not belong together, or if no FMU can be built;
    RunFailed with the FMU's sentence.
    """
    tell = progress or (lambda _: None)
    with fmu_of(fmu, backend) as file:
        return _check(parameters, read_fmu(file), os.fspath(fmu), record, period, filters, as_measured, tell)


def _check(
    parameters: ParameterSet, described: FMU, given: str, record: Record, period: float | None,
    filters: Iterable[str], as_measured: bool, tell: Progress,
) -> CheckReport:  # fmt: skip
    """given : the file as the user named it."""
    _check_arteries(parameters, described)
    if not as_measured:
        sites = {name.removesuffix(".R0") for name in described.starts if name.endswith(".R0")}
        numbers = {s: [float(described.starts[f"{s}.{key}"]) for key in ("R0", "h")] for s in sites}
        check_plausible(record, {site: Artery(*each) for site, each in numbers.items()})
    mode, driver, source, compared, starts = _plan(parameters, described, record)
    network = with_filters(read_network(Path(described.path)), filters)
    tell("aligning the beats")
    beats = align(record, period)
    drive = flowed(beats, network, source)
    if mode == "bench":
        starts = {**starts, "network.P_0": float(drive[0])}
    K = int(_TRUSTED * min(beats.N, steps_per_beat(described, beats.T)) / 2)
    noise = {name: beats.covariance((name, source))[: K + 1] for name in compared}
    noisy = tuple(name for name in compared if is_noisy(noise[name], beats, name))
    tell("running the FMU")
    answer, response = _runs(parameters, described, driver, drive, beats, starts, noisy, K, tell)
    if response:
        own = undoable(network, source, (omega := beats.omega * np.arange(K + 1)))
        response = {name: H * filtered(network, name, omega) / own for name, H in response.items()}
    waveforms = {
        name: Waveform(beats.mean(name), _shown(network, name, answer.values[name], beats), beats.scatter(name))
        for name in compared
    }
    channels = tuple(compare_channel(name, waveforms[name], noise[name], response.get(name)) for name in compared)
    waveforms[source] = Waveform(beats.mean(source), beats.mean(source), beats.scatter(source))
    return CheckReport(
        mode,
        source,
        beats.T,
        channels,
        compare_loops(waveforms),
        {
            "record": {"path": beats.source, "sha256": beats.sha256}
            | ({"columns": dict(beats.told)} if beats.told else {}),
            "fmu": {"path": given, "name": described.name, "guid": described.guid, "tool": described.tool},
            "parameter_set": {
                "name": parameters.name,
                "texts": dict(parameters.texts),
                "values": {name: asdict(value) for name, value in parameters.values.items()},
                "provenance": dict(parameters.provenance),
            },
        },
        {
            "beats_measured": beats.n_beats,
            "samples_a_beat": beats.N,
            "beats_run": answer.beats,
            "change": answer.change,
            "step": {"value": beats.T / steps_per_beat(described, beats.T), "unit": "s"},
            "harmonics": K,
        },
        (*beats.warnings, *_warnings(parameters, described, record, compared, source, answer, starts)),
        waveforms,
    )


def _runs(
    parameters: ParameterSet, described: FMU, driver: str, drive: Array, beats: Beats,
    starts: Mapping[str, float | str], noisy: tuple[str, ...], K: int, tell: Progress,
) -> tuple[Answer, dict[str, Array]]:  # fmt: skip
    """The FMU's periodic response, and that of the ``noisy`` channels to each harmonic of the drive."""
    try:
        with answering(described, driver, drive, beats.T, starts) as (running, answer):
            if not noisy:
                return answer, {}
            tell("running the FMU with a slightly different beat")
            return answer, _response(running, driver, drive, beats, starts, answer, noisy, K)
    except RunFailed as error:
        raise RunFailed(" ".join((str(error), *_of_another(parameters, described)))) from None


# --- what belongs together ----------------------------------------------------------------------------------------


def _plan(
    parameters: ParameterSet, fmu: FMU, record: Record
) -> tuple[str, str, str, tuple[str, ...], dict[str, float | str]]:
    """Mode, driven input, driving channel, channels to compare, start values."""
    starts = parameters.start_values()
    further = [name for name in fmu.inputs if name.endswith((".inlet.Q", ".inlet.P"))]
    if further:
        raise InputError(
            f"{fmu.name}: an FMU with further inlets ({_some(further)}), but records say what drives one; "
            "check the FMU of a network with one inlet."
        )
    if INFLOW in record.channels:
        mode, driver, source = "network", INFLOW, INFLOW
        compared = tuple(name for name in record.channels if name in fmu.outputs)
        if not compared:
            raise InputError(
                f"{record.path}: none of its channels ({_some(record.channels)}) is an output of the FMU {fmu.name} "
                f"({_some(fmu.outputs)}); check it against the FMU of the network that was recorded."
            )
    else:
        site = _bench_site(fmu, record)
        mode, driver, source, compared = "bench", f"{site}.outlet.P_venous", f"{site}.P", (f"{site}.R",)
        starts = own_values(site, parameters).start_values()
        if not any(name.startswith(f"{site}.") for name in starts):
            raise InputError(
                f"parameter set {parameters.name}: it has no value of {site}, the site on the bench; use its own set."
            )
    for name in starts:
        if name not in fmu.parameters and name not in fmu.inputs:
            raise InputError(
                f"{name} of the parameter set {parameters.name}: the FMU {fmu.name} has no such variable; "
                "use the FMU of the network that the set belongs to, or leave the value out."
            )
    return mode, driver, source, compared, starts


def _check_arteries(parameters: ParameterSet, fmu: FMU) -> None:
    """Raise ValueError if R0 or h show that an artery of the set differs from that of its name in the FMU."""
    for name, entry in parameters.values.items():
        if not name.endswith((".R0", ".h")) or name not in fmu.starts:
            continue
        own, value = float(fmu.starts[name]), entry.value
        if not 1.0 / ANOTHER < value / own < ANOTHER:
            raise InputError(
                f"parameter set {parameters.name}: its {name} is {1e3 * value:.4g} mm, that of the FMU {fmu.name} is "
                f"{1e3 * own:.4g} mm: the set is of another artery or network; use the FMU that it belongs to."
            )


def _of_another(parameters: ParameterSet, fmu: FMU) -> list[str]:
    """A sentence if the set was calibrated in a network of another name."""
    network = parameters.provenance.get("network", fmu.name)
    text = f"The parameter set {parameters.name} was calibrated in the network {network}, and the FMU is {fmu.name}."
    return [text] if network != fmu.name else []


def _bench_site(fmu: FMU, record: Record) -> str:
    """The site of a bench FMU: one segment, a prescribed pressure at its end, P and R in the record."""
    segments = [name.removesuffix(".L") for name in fmu.parameters if name.endswith(".L")]
    site = segments[0] if len(segments) == 1 else ""
    driven = f"{site}.outlet.P_venous" in fmu.inputs and f"{site}.R" in fmu.outputs
    own = [
        name for name in fmu.parameters if name.startswith(f"{site}.outlet.")
    ]  # R_t, R1 …: not a prescribed pressure
    if not driven or own:
        raise InputError(
            f"{record.path}: it has no inlet.Q, which the FMU {fmu.name} needs; record the inflow, "
            "or check P and R of one site with a bench FMU of it."
        )
    missing = [name for name in (f"{site}.P", f"{site}.R") if name not in record.channels]
    if missing:
        raise InputError(
            f"{record.path}: {' and '.join(missing)} is missing for the bench FMU {fmu.name}; "
            f"it holds {_some(record.channels)}."
        )
    return site


def _some(names: Any) -> str:
    listed = list(names)
    return ", ".join(listed[:8]) + (", …" if len(listed) > 8 else "")


def _warnings(
    parameters: ParameterSet,
    fmu: FMU,
    record: Record,
    compared: tuple[str, ...],
    source: str,
    answer: Answer,
    starts: Mapping[str, float | str],
) -> tuple[str, ...]:
    found = _of_another(parameters, fmu) if source == INFLOW else []
    if answer.change > PERIODIC:
        found.append(
            f"The FMU is not periodic after {answer.beats} beats: the last differs by {answer.change:.1e} from the one "
            "before. Its Windkessels fill too slowly; check their R2 and C."
        )
    uncompared = [name for name in record.channels if name not in compared and name != source]
    if uncompared:
        found.append(f"Not compared, because the FMU {fmu.name} has no such output here: {', '.join(uncompared)}.")
    unused = [name for name in parameters.start_values() if name not in starts]
    if unused:
        found.append(f"Not used on this bench: {_some(unused)}.")
    return tuple(found)


# --- comparing ----------------------------------------------------------------------------------------------------


def _shown(network: Network, name: str, values: Array, beats: Beats) -> Array:
    """(N,) a simulated beat after the known filter of its channel, with its known zero."""
    X = np.fft.rfft(interpolated(values, beats.N))
    return np.fft.irfft(X * filtered(network, name, beats.omega * np.arange(len(X))), beats.N) + zero_of(network, name)


def _response(
    fmu: FMU,
    driver: str,
    drive: Array,
    beats: Beats,
    starts: Mapping[str, float | str],
    answer: Answer,
    names: tuple[str, ...],
    K: int,
) -> dict[str, Array]:
    """H_k of every channel : (K + 1,): its change of harmonic k over that of the drive.

    All harmonics are perturbed at once, in random phase and by 1 % together: the network is nearly linear in such a
    small change.
    """
    phases = np.random.default_rng(_SEED).uniform(0.0, 2.0 * np.pi, K + 1)
    phases[0] = 0.0
    size = _NUDGE * float(np.std(drive)) / np.sqrt(2.0 * K + 1.0)
    nudge = size * np.exp(1j * phases)
    nudged = drive + np.fft.irfft(nudge, beats.N, norm="forward")
    other = periodic_answer(fmu, driver, nudged, beats.T, starts)
    return {
        name: coefficients(interpolated(other.values[name] - answer.values[name], beats.N))[: K + 1] / nudge
        for name in names
    }
