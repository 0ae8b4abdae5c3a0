"""A cohort of virtual animals: synthetic bench recordings of every artery of the paper. No public recording exists.

The means are the paper's (Table 1 and its text); the spread between animals is our choice, as are heart rates,
pressures and sensors: see :func:`virtual_cohort`. The truth is stored apart from the recordings, and animals and files
are named ``virtual-…``, which labels every result.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solver.errors import InputError
from solver.io.writing import write_folder

from ..records.read.record import Array, record_content
from ..records.virtual import SITES, VirtualWall, jarvik_pressure, measured, pressure_at, solve_radii, table_wall
from ..results.result_files import json_text

SD = 0.20  # of E and of φ0, relative
COMMON = 0.5  # share of their variance common to the sites of an animal
CORRELATION = 0.8  # of log E and log φ0: the paper finds φ0/E nearly constant
SD_R0 = 0.01
SD_RATIO = 0.30  # of φ_NL/φ0
SD_MEASURED = 0.005  # error of the measured R0, relative
PERIODS = (0.40, 0.62)  # s
MEANS = (10e3, 12e3)  # Pa
PULSES = (3.5e3, 4.5e3)  # Pa
NOISE = (-20.0, 300.0)  # allowed dB: from ten times the pulse to below rounding

_POINTS = 256  # of a beat at which the wall is solved: five times the harmonics of the pressure

README = """Virtual animals: synthetic data, made by a computer program from the wall law and random numbers.
No animal was measured, and no public recording of the sheep of the paper exists.

cohort.csv   one line per animal and site: record, wall thickness h, measured unstressed radius R0
virtual-*_*.csv  the recordings: time, pressure, radius, with synthetic noise, drift and quantisation
             (the names of animals and files begin with "virtual": keep that, results are labelled by it)
truth.json   the parameters they were made with: for tests of a fit, never for the fit itself

Means: Table 1 and the text of Ghigo et al. (2017). All else is an assumption of this program.
Spread between animals (log-normal): 20 % of E and of phi0, half of the variance common to the sites of an animal,
correlation 0.8 between log E and log phi0 (so 12.6 % of phi0/E); 1 % of R0; 30 % of phiNL/phi0.
The measured R0 is the true one with an error of 0.5 %. Each recording has its own period (0.40 to 0.62 s), mean
pressure (10 to 12 kPa) and pulse (3.5 to 4.5 kPa). Noise, drift and quantisation of the sensors are in truth.json.
"""


@dataclass(frozen=True)
class VirtualRecording:
    """A synthetic bench recording: time, P, R : (n,) in SI, and measured R0, h [m]. animal : "virtual-S01"."""

    animal: str
    site: str
    time: Array
    P: Array
    R: Array
    R0: float
    h: float

    @property
    def file(self) -> str:
        """Name of its file, "virtual-S01_AA.csv", which labels every figure and fit of it."""
        return f"{self.animal}_{self.site}.csv"


@dataclass(frozen=True)
class Truth:
    """The true parameters of a recording: the wall, period [s], mean and pulse of P [Pa]."""

    wall: VirtualWall
    T: float
    mean: float
    pulse: float


@dataclass(frozen=True)
class VirtualCohort:
    """Recordings of virtual animals, and separately their truth by (animal, site).

    settings : the arguments of :func:`virtual_cohort`.
    """

    seed: int
    settings: Mapping[str, Any]
    recordings: tuple[VirtualRecording, ...]
    truth: Mapping[tuple[str, str], Truth]


def virtual_cohort(
    seed: int,
    animals: int = 11,
    sites: Sequence[str] = tuple(SITES),
    *,
    dB: float = 40.0,
    beats: int = 15,
    rate: float = 200.0,
    drift: float = 0.02,
    bits: int | None = 12,
    exact_means: bool = False,
) -> VirtualCohort:
    """Recordings of ``animals`` at ``sites`` of the paper, all random numbers from ``seed``.

    Means are the paper's. Spread (ours), log-normal: 20 % of E and of φ0, half of the variance common to an animal's
    sites, correlation 0.8 of their logarithms, so 12.6 % of φ0/E; 1 % of R0, 30 % of φ_NL/φ0, each site by itself;
    h as in Table 1. Every recording has its own period (0.40–0.62 s), mean (10–12 kPa), pulse (3.5–4.5 kPa) and phase.

    dB, drift, bits : sensors, as in :func:`fitting.records.virtual.measured`. rate : [1/s].
    exact_means : scale E, φ0, R0 and φ_NL so that their means over these animals, rather than over the population, are
    the paper's; intervals are then too wide.
    Raises ValueError for an unknown site, or a number out of its range, before anything is computed.
    """
    _check(animals, sites, dB, beats, rate, drift, bits)
    rng = np.random.default_rng(seed)
    herd = [_animal(rng, sites) for _ in range(animals)]
    if exact_means:
        herd = _centred(herd, [table_wall(site) for site in sites])
    truth = {}
    for number, walls in enumerate(herd, start=1):
        for site, wall in zip(sites, walls, strict=True):
            T, mean, pulse = (float(rng.uniform(*span)) for span in (PERIODS, MEANS, PULSES))
            truth[f"virtual-S{number:02d}", site] = Truth(wall, T, mean, pulse)
    pressures = np.array([jarvik_pressure(each.T, each.mean, each.pulse) for each in truth.values()])
    periods = np.array([each.T for each in truth.values()])
    radii = solve_radii([each.wall for each in truth.values()], pressures, periods, _POINTS)
    recordings = []
    for (animal, site), each, p, R in zip(truth, truth.values(), pressures, radii, strict=True):
        time = np.arange(int(np.ceil(beats * each.T * rate))) / rate
        t = time + rng.uniform(0.0, each.T)
        c = np.fft.rfft(R)[: _POINTS // 2] * (2.0 / _POINTS)
        c[0] *= 0.5
        P, R = (measured(pressure_at(x, each.T, t), rng, dB, drift, bits) for x in (p, c))
        R0 = each.wall.R0 * float(np.exp(rng.normal(0.0, SD_MEASURED)))
        recordings.append(VirtualRecording(animal, site, time, P, R, R0, each.wall.h))
    settings = {
        "dB": dB,
        "beats": beats,
        "rate": rate,
        "drift": drift,
        "bits": bits,
        "exact_means": exact_means,
    }
    return VirtualCohort(seed, settings, tuple(recordings), truth)


def _check(
    animals: int, sites: Sequence[str], dB: float, beats: int, rate: float, drift: float, bits: int | None
) -> None:
    """Raise ValueError, one sentence, for the first invalid argument."""
    unknown = [site for site in sites if site not in SITES]
    if unknown:
        raise InputError(f"virtual cohort: no site {unknown[0]!r} in the paper; use {', '.join(SITES)}.")
    limits = [
        ("animals", animals, animals >= 1, "at least 1"),
        ("beats", beats, beats >= 2, "at least 2, as many as a period needs"),
        ("rate", rate, 0.0 < rate < np.inf, "positive and finite, in samples a second"),
        ("dB", dB, *_range(dB, *NOISE)),
        ("drift", drift, *_range(drift, 0.0, 100.0)),
    ]
    if bits is not None:
        limits.append(("bits", bits, *_range(bits, 1, 64)))
    for name, value, allowed, meaning in limits:
        if not allowed:
            raise InputError(f"virtual cohort: {name} = {value:g}: must be {meaning}.")


def _range(value: float, low: float, high: float) -> tuple[bool, str]:
    """Whether the value is in it (NaN is not), and the words for it."""
    return low <= value <= high, f"from {low:g} to {high:g}"


def write_cohort(
    cohort: VirtualCohort, folder: str | os.PathLike[str], progress: Callable[[float, str], None] | None = None
) -> Path:
    """Write recordings, cohort.csv, truth.json and a README.txt into a folder; return the path of cohort.csv.

    All of them or none; a missing folder is created. progress : called with the finished fraction and the file.
    Raises ValueError if it cannot be written.
    """
    files: dict[str, str | bytes] = {}
    lines = ["animal,site,record,h [mm],R0 [mm]"]
    for i, each in enumerate(cohort.recordings):
        if progress:
            progress(i / len(cohort.recordings), each.file)
        channels = {f"{each.site}.P": each.P, f"{each.site}.R": each.R}
        units = {f"{each.site}.P": "mmHg", f"{each.site}.R": "mm"}
        files[each.file] = record_content(each.file, each.time, channels, units)
        lines.append(f"{each.animal},{each.site},{each.file},{1e3 * each.h:.4g},{1e3 * each.R0:.5g}")
    truth = {
        "data": "virtual animals: synthetic data, not measured",
        "seed": cohort.seed,
        "settings": cohort.settings,
        "recordings": [
            {"animal": animal, "site": site, **asdict(each)} for (animal, site), each in cohort.truth.items()
        ],
    }
    files |= {"README.txt": README, "truth.json": json_text(truth, indent=1), "cohort.csv": "\n".join(lines) + "\n"}
    return write_folder(folder, files)[-1]


def _animal(rng: np.random.Generator, sites: Sequence[str]) -> list[VirtualWall]:
    """The walls of one animal."""
    common = _stiffness_and_viscosity(rng, COMMON)
    walls = []
    for site in sites:
        R0, h, E, phi0, ratio = SITES[site]
        factors = common * _stiffness_and_viscosity(rng, 1.0 - COMMON)
        E, phi0 = E * float(factors[0]), phi0 * float(factors[1])
        R0, ratio = R0 * _lognormal(rng, SD_R0), ratio * _lognormal(rng, SD_RATIO)
        walls.append(VirtualWall(R0, h, E, phi0, ratio * phi0))
    return walls


def _centred(herd: list[list[VirtualWall]], means: list[VirtualWall]) -> list[list[VirtualWall]]:
    """The same animals, each site's E, φ0, R0 and φ_NL scaled so that their means are those given."""
    names = ("E", "phi0", "R0", "phiNL")
    drawn = np.array([[[getattr(wall, name) for name in names] for wall in walls] for walls in herd])
    scaled = drawn * np.array([[getattr(wall, name) for name in names] for wall in means]) / drawn.mean(axis=0)
    return [
        [replace(wall, E=E, phi0=phi0, R0=R0, phiNL=phiNL) for wall, (E, phi0, R0, phiNL) in zip(*pair, strict=True)]
        for pair in zip(herd, scaled.tolist(), strict=True)
    ]


def _stiffness_and_viscosity(rng: np.random.Generator, part: float) -> Array:
    """Factors on E and φ0 of mean 1 : (2,), with the fraction ``part`` of the variance of their logarithms."""
    variance = part * np.log1p(SD**2)
    normal = rng.multivariate_normal([0.0, 0.0], variance * np.array([[1.0, CORRELATION], [CORRELATION, 1.0]]))
    return np.asarray(np.exp(normal - variance / 2.0))


def _lognormal(rng: np.random.Generator, sd: float) -> float:
    """A factor of mean 1 and relative standard deviation ``sd``."""
    variance = float(np.log1p(sd**2))
    return float(np.exp(rng.normal(-variance / 2.0, np.sqrt(variance))))
