"""The check of a parameter set: FMUs in fresh processes against records of which everything is known.

The records are synthetic. Those of networks come from the solver, called directly; those of the bench from an
integrator of SciPy that shares nothing with it.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checked import COARSE, Array, N, T, bench_set, recorded
from fmus import Store

from build_fmu import build
from fitting.check import fmu_run
from fitting.check.agreement import Waveform, compare_loops
from fitting.check.fmu_check import CheckReport, check
from fitting.check.fmu_run import RunFailed, _in_phase
from fitting.inference.models.bench_network import bench_network
from fitting.pages import check_page
from fitting.pages.check_page import page, write_check
from fitting.records.channels.spectral import interpolated
from fitting.records.read.record import Record
from fitting.results.parameter_set import ParameterSet, Value, read_set
from solver import Inlet, Network, Segment, Settings, Site, Windkessel, load, simulate_periodic
from solver.io.exit_codes import HostDied

pytestmark = pytest.mark.usefixtures("one_process")
SITES = ("AA", "MD", "CA")


def inflow(t: Array) -> Array:
    """The half-sine of the sheep up to its 20th harmonic: nothing that 125 samples a beat do not hold."""
    X = 2.0 * np.fft.rfft(Inlet("AA").Q(np.arange(500) * 1e-3), norm="forward")[:21]
    X[0] /= 2.0
    return np.polynomial.polynomial.polyval(np.exp(2j * np.pi * np.asarray(t) / T), X).real


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("check")


@pytest.fixture(scope="module")
def fmu(sheep: Network, fast_fmu: Callable[..., Path]) -> Path:
    return fast_fmu(sheep, COARSE)


@pytest.fixture(scope="module")
def bench(stored: Store) -> Path:
    return stored(build, bench_network("AA", bench_set()), settings=COARSE)


@pytest.fixture(scope="module")
def table1() -> ParameterSet:
    return read_set("sheep_table1")


@pytest.fixture(scope="module")
def truth(sheep: Network, table1: ParameterSet) -> dict[str, Array]:
    """The beat of the sheep network with Table 1 and its elastic law, N samples."""
    beat = simulate_periodic(table1.apply(sheep), inflow, settings=COARSE, tolerance=1e-6)
    names = ["inlet.Q", "inlet.P", *(f"{site}.{kind}" for site in SITES for kind in "PQR")]
    return {name: beat[name][:-1][:: (len(beat.time) - 1) // N] for name in names}


@pytest.fixture(scope="module")
def noisy(folder: Path, truth: dict[str, Array]) -> Record:
    """The same with 40 dB of noise in every channel."""
    return recorded(folder, truth, 0.01)


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory, truth: dict[str, Array]) -> Record:
    """The same without noise: one run of the FMU is enough."""
    return recorded(tmp_path_factory.mktemp("quiet"), truth)


# --- networks -----------------------------------------------------------------------------------------------------


def test_agrees_without_noise(fmu: Path, table1: ParameterSet, truth: dict[str, Array], quiet: Record) -> None:
    """The solver's own beat: 3e-4 of the pulse at the sites, 1.5e-3 at the inlet; no noise, so nothing is whitened.

    What is left is the FMU's inflow, linear between its steps of 2 ms; the solver takes the true one at its stages.
    """
    report = check(table1, fmu, quiet)
    assert [c.name for c in report.channels] == [name for name in truth if name != "inlet.Q"]
    assert all(c.largest <= (1.7e-3 if c.name == "inlet.P" else 3.5e-4) for c in report.channels)
    assert max(abs(loop.simulated / loop.measured - 1.0) for loop in report.loops) <= 5e-4
    assert all(c.whitened is None and c.mean_z is None for c in report.channels)
    assert report.T == pytest.approx(T, rel=1e-6)


def test_energy_lost_is_of_the_area() -> None:
    """An ellipse of P = P_0 + a cos x against A = A_0 + b cos(x - d): ∮ P dA = π a b sin d, 8.4 mJ/m, to 1e-9, where
    ∮ P dR would be 0.1 J/m²; half of it from a FMU with half the pressure."""
    x = 2.0 * np.pi * np.arange(200) / 200
    P, A = 1e4 + 2e3 * np.cos(x), 3e-4 + 2e-5 * np.cos(x - 0.067)
    waves = {"CA.P": Waveform(P, P / 2.0, 0.0 * P), "CA.R": Waveform(np.sqrt(A / np.pi), np.sqrt(A / np.pi), 0.0 * A)}
    (loop,) = compare_loops(waves)
    assert loop.measured == pytest.approx(np.pi * 2e3 * 2e-5 * np.sin(0.067), rel=1e-9)
    assert loop.simulated == pytest.approx(loop.measured / 2.0, rel=1e-9)


@pytest.fixture(scope="module")
def report(fmu: Path, table1: ParameterSet, noisy: Record) -> CheckReport:
    return check(table1, fmu, noisy)


def test_noise_is_whitened_to_one(report: CheckReport) -> None:
    """True parameters, 40 dB on every channel and on the inflow: whitened RMS 1 within its scatter (46 harmonics).

    With an FMU at 1 ms and seeds 0 to 5 the mean over the sites was 0.965 to 1.05 (this seed, 5, is the largest).
    By its sensor's noise alone the pressure at the inlet seems more than twice off: that is the inflow's noise.
    """
    by_name = {c.name: c for c in report.channels}
    print(*(f"{c.name} {c.whitened:.2f} {c.whitened_sensor:.2f} {c.mean_z:.1f}" for c in report.channels))  # type: ignore[str-format]
    assert report.run["harmonics"] == 46
    assert all(0.8 <= c.whitened <= 1.25 for c in report.channels if c.whitened is not None)
    assert np.mean([c.whitened for c in report.channels if c.whitened]) == pytest.approx(1.0, abs=0.08)
    assert by_name["inlet.P"].whitened_sensor == pytest.approx(2.3, abs=0.4)
    assert max(abs(c.mean_z) for c in report.channels if c.mean_z is not None) <= 4.0


def test_wrong_wall_is_seen(fmu: Path, table1: ParameterSet, noisy: Record) -> None:
    """Without viscosity at CA: CA.R is the worst channel, beyond 50 times its noise; CA's loop ∮ P dA is closed (1e-3).

    The loop of AA, whose own wall is right, changes by less than 5 %.
    """
    wrong = replace(table1, values={**table1.values, "CA.phi0": Value(0.0, "Pa.s")})
    report = check(wrong, fmu, noisy)
    assert report.worst.name == "CA.R"
    assert report.worst.whitened is not None
    assert report.worst.whitened > 50.0
    assert report.title.startswith("differs by more than the noise; worst channel CA.R: ")
    loops = {loop.site: loop for loop in report.loops}
    assert abs(loops["CA"].simulated) <= 1e-3 * loops["CA"].measured
    assert loops["AA"].simulated == pytest.approx(loops["AA"].measured, rel=0.05)


def test_known_filters_are_laid_over_both(
    tmp_path: Path, fmu: Path, table1: ParameterSet, truth: dict[str, Array]
) -> None:
    """A flow meter of 15 Hz and order 2, a pressure of 20 Hz: with both said, the FMU agrees to 1.5e-3 of the pulse;
    without, a channel is off by more than 10 %."""
    f, shown = np.arange(N // 2 + 1) / T, dict(truth)
    for name, H in (
        ("inlet.Q", 1.0 / (1.0 + 2.0**0.5 * 1j * f / 15.0 - (f / 15.0) ** 2)),
        ("MD.P", 1.0 / (1.0 + 0.05j * f)),
    ):
        shown[name] = np.fft.irfft(np.fft.rfft(truth[name]) * H, N)
    record = recorded(tmp_path, shown)
    filters = ["inlet.Q=lowpass 15 Hz order 2", "MD.P=lowpass 20 Hz"]
    assert check(table1, fmu, record, filters=filters).worst.largest < 1.5e-3
    assert check(table1, fmu, record).worst.largest > 0.1


def slow_network() -> Network:
    """One tube into a Windkessel of 1.2 s: from rest, dozens of beats until it repeats."""
    tube = Segment("AA", L=0.04, R0=9.48e-3, h=0.38e-3, E=1.539e6, phi0=25451.0)
    end = Windkessel("AA", R1=1e7, C=1.2e-8, R2=1e8)
    return Network("slow", (tube,), Inlet("AA"), outlets=(end,), sites=(Site("AA", "AA"),))


def test_runs_until_periodic(stored: Store, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A Windkessel of 1.2 s, of whose transient two thirds are left after a beat: three runs of five beats, the second
    and third from a corrected start; from rest it would be 75 beats in runs of 5, 10, 20 and 40.

    The pressure's mean is the solver's to 2e-5 of its pulse, 1e-5 measured. Its waves differ by 2.6e-3 in the steps of
    4 ms that are taken here, 6.5e-4 in 2 ms, 1.4e-4 in 1 ms: between steps the FMU's inflow is linear.
    """
    network, settings = slow_network(), Settings(dt=4e-3, element_length=0.1)
    beat = simulate_periodic(network, inflow, settings=settings, tolerance=1e-6)
    channels = {name: beat[name][:-1] for name in ("inlet.Q", "AA.P")}
    real, runs = fmu_run._run, list[int]()

    def counted(fmu, driver, beat, h, n, beats, starts):  # type: ignore[no-untyped-def]
        runs.append(beats)
        return real(fmu, driver, beat, h, n, beats, starts)

    monkeypatch.setattr(fmu_run, "_run", counted)
    fmu = stored(build, network, settings=settings)
    report = check(ParameterSet("none", {}), fmu, recorded(tmp_path, channels), as_measured=True)  # of 14 mmHg
    assert report.run["beats_run"] == 5
    assert report.run["change"] <= 1e-4
    assert sum(runs) <= 15
    assert report.worst.largest <= 2.8e-3
    assert abs(report.worst.mean_error) <= 2e-5 * report.worst.pulse
    assert not report.warnings


def test_says_when_it_is_not_periodic(
    monkeypatch: pytest.MonkeyPatch, fmu: Path, table1: ParameterSet, quiet: Record
) -> None:
    """After three beats the last differs from the second, by more than what is asked for here: a warning."""
    monkeypatch.setattr(fmu_run, "BEATS", (3,))
    monkeypatch.setattr(fmu_run, "_SHOTS", 1)
    for module in ("fmu_run", "fmu_check"):
        monkeypatch.setattr(f"fitting.check.{module}.PERIODIC", 1e-14)
    report = check(table1, fmu, quiet)
    assert re.match(
        r"The FMU is not periodic after 3 beats: the last differs by .* from the one before\.", report.warnings[0]
    )


# --- what is written ----------------------------------------------------------------------------------------------


def of_site(report: CheckReport, site: str) -> CheckReport:
    """The report of one site alone, which is drawn sooner."""
    channels = tuple(c for c in report.channels if c.name.startswith(f"{site}."))
    return replace(report, channels=channels, loops=tuple(loop for loop in report.loops if loop.site == site))


def test_written_report(tmp_path: Path, report: CheckReport) -> None:
    """JSON with every number, one page that needs nothing else, PNG figures; twice the same bytes."""
    report = of_site(report, "CA")
    page = write_check(report, tmp_path / "deep" / "report")
    files = {path.name: path.read_bytes() for path in page.parent.iterdir()}
    assert set(files) == {"check.json", "check.html", "waveforms.png", "residuals.png", "loops.png"}
    data = json.loads(files["check.json"])
    assert data["channels"]["CA.Q"]["relative"] == {c.name: c for c in report.channels}["CA.Q"].relative
    assert data["title"] == report.title
    assert data["sources"]["record"]["sha256"] == report.sources["record"]["sha256"]
    assert data["sources"]["fmu"]["guid"].startswith("{")
    text = files["check.html"].decode("utf-8")
    shown = re.findall(r'src="([^"]{0,30})', text)
    assert len(shown) == 3
    assert all(address.startswith("data:image/png;base64,") for address in shown)
    for expected in (report.title[1:], data["sources"]["record"]["sha256"], data["sources"]["fmu"]["guid"], "Ghigo"):
        assert expected in text
    assert all(name in text for name in data["channels"])
    assert data["loops"]["CA"]["unit"] == "J/m" and "∮ P dA measured [mJ/m]" in text
    assert f"<td>{1e3 * data['loops']['CA']['measured']:.4g}</td>" in text
    assert all(files[name].startswith(b"\x89PNG") for name in files if name.endswith(".png"))
    write_check(report, tmp_path / "again")
    assert all((tmp_path / "again" / name).read_bytes() == content for name, content in files.items())


def test_page_shows_the_set_and_no_raw_data(report: CheckReport) -> None:
    """Every value in the unit that people read, with its interval; of a calibration's covariance the name alone."""
    sources = json.loads(json.dumps(report.sources))
    sources["parameter_set"] |= {
        "values": {
            "CA.E": {"value": 4.5558e6, "unit": "Pa", "ci95": [4.4806e6, 4.6304e6]},
            "CA.outlet.R_t": {"value": 0.3, "unit": "1", "ci95": None},
        },
        "provenance": {"network": "sheep", "covariance": [[5.52e-8, -2.6e-8], [-2.6e-8, 1.06e-7]],
                       "unknowns": {"all.E": {"x": -0.000525163, "moves": {"CA.E": 1.0}}}},
    }  # fmt: skip
    text = page(replace(report, sources=sources), {})
    assert "<td>CA.E</td><td>4.556</td><td>4.481 … 4.630</td><td>MPa</td>" in text
    assert "<td>CA.outlet.R_t</td><td>0.3</td><td>–</td><td>–</td>" in text
    assert "<dt>its network</dt><dd>sheep</dd>" in text and "its covariance, unknowns</dd>" in text
    assert "5.52" not in text and "000525" not in text and "e-0" not in text and "e+0" not in text


def test_page_escapes(report: CheckReport) -> None:
    """A script in the provenance of the set is text on the page, not markup."""
    sources = json.loads(json.dumps(report.sources))
    sources["parameter_set"]["provenance"] = {"source": "<script>alert(1)</script>"}
    text = page(replace(report, sources=sources), {})
    assert "<script>" not in text
    assert "&lt;script&gt;" in text


def test_report_is_not_written(tmp_path: Path, report: CheckReport, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file where the directory should be: one sentence with its path and what to do. Figures are not drawn here."""
    monkeypatch.setattr(check_page, "figures", lambda report: {})
    monkeypatch.setattr(check_page, "page", lambda report, drawings: "")
    (tmp_path / "taken").write_text("")
    with pytest.raises(ValueError, match=r"taken: is a file, not a folder; give another folder\."):
        write_check(report, tmp_path / "taken")


# --- refusals -----------------------------------------------------------------------------------------------------

X = 1e-5 * (1.0 + np.sin(2 * np.pi * np.arange(100) / 100))
P = 1e9 * X


@pytest.mark.parametrize(
    ("values", "channels", "which", "sentence"),
    [
        (
            {"XX.E": Value(1e6, "Pa")},
            {"inlet.Q": X, "AA.P": P},
            "fmu",
            r"XX\.E of the parameter set x: the FMU sheep has no such variable; use the FMU of the network that",
        ),
        (
            {},
            {"inlet.Q": X, "aorta.P": P},
            "fmu",
            r"record\.csv: none of its channels \(inlet\.Q, aorta\.P\) is an output of the FMU sheep \(inlet\.P, ",
        ),
        (
            {},
            {"AA.P": P, "AA.Q": X},
            "fmu",
            r"record\.csv: it has no inlet\.Q, which the FMU sheep needs; record the inflow, or check P and R of one ",
        ),
        (
            {},
            {"AA.P": P, "AA.Q": X},
            "bench",
            r"record\.csv: AA\.R is missing for the bench FMU bench_AA; it holds AA\.P, AA\.Q\.$",
        ),
        (
            {"CA.E": Value(1e6, "Pa")},
            {"AA.P": P, "AA.R": 1e-2 + X},
            "bench",
            r"parameter set x: it has no value of AA, the site on the bench; use its own set\.$",
        ),
    ],
)
def test_refused(
    tmp_path: Path,
    request: pytest.FixtureRequest,
    values: dict[str, Value],
    channels: dict[str, Array],
    which: str,
    sentence: str,
) -> None:
    """Set, FMU and record that do not belong together: one sentence, before anything runs."""
    with pytest.raises(ValueError, match=sentence):
        check(ParameterSet("x", values), request.getfixturevalue(which), recorded(tmp_path, channels))


def test_refused_fmus(tmp_path: Path, noisy: Record) -> None:
    """No file, and a file that is no FMU: one sentence each, with the path."""
    with pytest.raises(
        ValueError, match=r"nowhere\.fmu: cannot be read \(No such file or directory\); check the path\."
    ):
        check(ParameterSet("x", {}), tmp_path / "nowhere.fmu", noisy)
    with pytest.raises(ValueError, match=r"record\.csv: not an FMU; build one with arterial-fmu build\."):
        check(ParameterSet("x", {}), noisy.path, noisy)


def test_value_that_the_fmu_refuses(fmu: Path, noisy: Record) -> None:
    """phi0 = -1 Pa·s: a fit may leave the allowed range; the FMU's own sentence says so, with the range."""
    with pytest.raises(RunFailed, match=r"AA\.phi0 = -1 Pa\.s is not allowed: wall viscosity phi0 must lie in "):
        check(ParameterSet("x", {"AA.phi0": Value(-1.0, "Pa.s")}), fmu, noisy)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (
            lambda text: text[: text.rindex("\n", 0, -1) + 1],
            r"sheep\.fmu: the run stopped at 0\.998 s instead of 1 s",
        ),
        (None, r"sheep\.fmu: the process that ran it died of signal 11 \(SIGSEGV\); ask"),
    ],
)
def test_run_must_reach_its_stop_time(
    monkeypatch: pytest.MonkeyPatch,
    fmus: dict[str, Path],
    table1: ParameterSet,
    noisy: Record,
    spoil: Callable[[str], str] | None,
    sentence: str,
) -> None:
    """A result that ends a step early is no result, nor is that of a process that crashed in silence (two beats)."""
    monkeypatch.setattr(fmu_run, "BEATS", (2,))
    real = subprocess.run

    def run(line: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        if spoil is None:
            return subprocess.CompletedProcess(line, -11, "", "")
        done = real(line, **options)
        out = Path(line[line.index("--out") + 1])
        out.write_text(spoil(out.read_text()))
        return done

    monkeypatch.setattr(fmu_run.subprocess, "run", run)
    with pytest.raises(HostDied if spoil is None else RunFailed, match=sentence):
        check(table1, fmus["coarse sheep"], noisy, period=T)


# --- pieces -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("n", "m"), [(16, 100), (17, 100), (100, 17), (16, 16), (17, 34)])
def test_fourier_is_exact(n: int, m: int) -> None:
    """A beat of up to 7 harmonics, from n samples to m, more or fewer: to 1e-13."""
    X = np.random.default_rng(1).normal(size=(2, 8))

    def beat(phase: Array) -> Array:
        k = 2 * np.pi * np.outer(phase, np.arange(8))
        return np.cos(k) @ X[0] + np.sin(k) @ X[1]

    assert interpolated(beat(np.arange(n) / n), m) == pytest.approx(beat(np.arange(m) / m), abs=1e-13)


@pytest.mark.parametrize("late", [0, 37, 150])
def test_a_run_begins_at_the_phase_of_the_networks_own_pulse(late: int) -> None:
    """Its periodic start is the state there: x = 1.3 q(t - 37 T/200) with another mean begins at sample 37."""
    network = load("sheep")
    pulse = network.inlet.Q(network.inlet.T / 200 * np.arange(200))
    assert _in_phase(1.3 * np.roll(pulse, late) + 1e-5, network) == late
