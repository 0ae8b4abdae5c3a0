"""Laws that are learned from records of another solver: what they leave of held-out beats and of another recording.

    python benchmarks/learned.py [--seeds 3] [--nulls 100] [--dB 40] [--small] [--json FILE]

Records of one artery by the generator of tests/truth, with a wall that no effect of the catalogue describes, judged and
learned from as `discover` does; every law runs in its FMU on the held-out beats. Gaps are whitened RMS, 1 is noise: of
the best that the catalogue has, of the learned law, and of the true one (its form given, its numbers fitted); then of
the same numbers on another recording of the same wall, with another heart, which no fit has seen. Nulls, of
three groups of the bank's plan, hide nothing; a law is asked for whatever their verdict is.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.table import JsonFile, Small, start, store, tabulate
from discrepancy.add.learning import Learnt, in_range, learns, learnt, stands
from discrepancy.find.study import Study, prepare
from discrepancy.findings.outcome import LearnedLaw
from discrepancy.name.scoring import weighed
from discrepancy.name.verdict import Naming
from discrepancy.show.fmu_validation import Run, free_run
from fitting.check.fmu_build import build_fmu
from fitting.check.fmu_run import RunFailed
from fitting.inference.extended_network import extended
from fitting.inference.fit import Fit
from fitting.inference.forward import Forward
from fitting.inference.hypothesis import Term, searched
from fitting.inference.runs import Runs
from fitting.records.read.record import Record
from solver.laws.effects import BY_NAME
from solver.network.description import Network
from solver.network.files import write_network
from tests.judged import judge
from tests.truth.anatomy import anatomy
from tests.truth.beat import Beat, at_phase
from tests.truth.detect import detect
from tests.truth.hide import Effect
from tests.truth.plan import GROUPS, seed_of, whole
from tests.truth.records import BEATS, Case, Made, make, truth_channels
from tests.truth.sensors import clock, measured, pulsatile
from tests.truth.shapes import arteries, ejection

SITES = ("AA", "MD")
LAW = BY_NAME["learned_wall"]
Row = dict[str, Any]


@dataclass(frozen=True)
class Hidden:
    """A law of the generator, its size, and the same in the form of a learned law: its term, and a range for it."""

    name: str
    size: float
    key: str
    low: float = 0.0
    rate: float = 1e3


HIDDEN = (
    Hidden("cubic_rate", 2.0, "learned_cubic"),
    Hidden("strain_viscosity", 15.0, "learned_rise"),
    Hidden("coulomb", 1e-3, "learned_friction", rate=0.2),  # tanh(ε̇/0.05), which is 1 beyond to 7e-4
)


def record_of(made: Made) -> Record:
    return Record("made", "", made.time, made.channels, {})


def another(made: Made, seed: int) -> Record:
    """Another recording of the same wall: another period, waveform and noise."""
    rng, case = np.random.default_rng((seed, 9)), made.case
    beat = Beat(float(rng.uniform(0.4, 0.6)), made.beat.K, made.beat.samples)
    heart = ejection(rng, beat, 1.0)
    drive = arteries(rng, beat, heart).pressure(heart, beat.omega)
    clean, _ = truth_channels(case, anatomy(made.base), made.nuisance, drive, beat)
    at = clock(rng, beat.T, BEATS)
    noise = {name: pulsatile(clean[name]) * 10.0 ** (-case.dB / 20.0) for name in case.names}
    channels = {n: measured(rng, at_phase(clean[n], at.phase), at, noise[n], beat.T) for n in case.names}
    return Record("another", "", at.time, channels, {})


def rms(problem: Forward, fit: Fit) -> float:
    """Of all that a fit leaves of a record under its numbers."""
    ((chi2, n),) = problem.predict([fit])
    return math.sqrt(chi2 / n)


def fmu_of(study: Study, network: Network, fit: Fit) -> tuple[Run, Callable[[], bytes]]:
    """The free run of the FMU of a network under the wave that a fit makes most probable."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.toml"
        write_network(study.problem.part(network), file)
        fmu = build_fmu(file, Path(folder), "auto")
        return free_run(fmu, study, fit, study.problem.wave(study.fitted, fit), {}), bytes


def offered(study: Study, base: Fit, found: Learnt, record: Record) -> LearnedLaw | None:
    before, _ = fmu_of(study, extended(study.network, base), base)
    with suppress(RunFailed):
        return stands(study, found, before, record, fmu_of)
    return None


def true_law(study: Study, hidden: Hidden, base: Fit, site: str) -> tuple[dict[str, float], Fit]:
    """The true form fitted, in a range that holds all of it."""
    numbers = {"learned_low": hidden.low, "learned_span": 0.4, "learned_rate": hidden.rate}
    ranges = {f"{site}.{key}": x for key, x in numbers.items()}
    problem = in_range(study.problem, ranges)
    (coordinate,) = LAW.learned(problem.network, site, (hidden.key,))
    (fit,) = problem.refit([(Term(LAW.name, site, (site,), (searched(LAW, coordinate),)),)], base)
    assert fit is not None
    return ranges, fit


def row(site: str, hidden: Hidden, dB: float, seed: int) -> Row:
    """One record with a hidden law."""
    made = make(Case("bench", site, dB, (Effect(hidden.name, (site,), hidden.size),)), seed)
    record = record_of(made)
    study, naming = judge(record, made.base)
    line: Row = {"hidden": hidden.name, "site": site, "seed": seed, "d_prime": detect(made).d_prime[0]}
    line |= {"verdict": naming.verdict, "law": None}
    if not learns(naming) or (found := learnt(study, naming, Runs())) is None:
        return line
    named = naming.best.fit if naming.verdict == "partial" else naming.base.fit
    law = offered(study, named, found, record)
    if law is None:
        return line
    ranges, right = true_law(study, hidden, naming.base.fit, site)
    held, other = study.problem.held_out(study.held_out, study.fitted), prepare(another(made, seed), made.base).problem
    every = (found.ranges, found.ranges, ranges)
    kept, unseen = ([in_range(problem, each) for each in every] for problem in (held, other))
    fits = (named, found.fit, right)
    return line | {
        "law": [key.partition("_")[2] for key in found.keys],
        "fmu": [law.before[1], law.after[1]],
        "held_out": [rms(p, f) for p, f in zip(kept, fits, strict=True)],
        "unseen": [rms(p, f) for p, f in zip(unseen, fits, strict=True)],
    }


def null(kind: str, group: str, index: int, case: Case) -> Row:
    """One record that hides nothing: whether a law is learned where one is asked for all the same."""
    made = make(case, seed_of(kind, GROUPS[group].tuning, index))
    study = prepare(record_of(made), made.base)
    (base,) = study.problem.refit([()])
    assert base is not None
    none = weighed(study.problem, base, study.terms)
    found = learnt(study, Naming("unknown", study.problem, none, (), (), {}, study.terms, 0.5), Runs())
    return {"group": group, "index": index, "law": found and list(found.keys)}


def nulls(n: int) -> list[tuple[str, str, int, Case]]:
    """The first nulls of the tuning plans of benches, the groups in turn."""
    each = [
        [("bench", g, i, c) for i, c in enumerate(whole("bench", g, GROUPS[g].tuning)) if not c.effects]
        for g in ("standard", "sensors", "varying")
    ]
    return [case for some in zip(*each, strict=False) for case in some][:n]


def main(
    seeds: Annotated[int, typer.Option(help="Records of every wall.")] = 3,
    null_records: Annotated[int, typer.Option("--nulls", help="Records that hide nothing.")] = 100,
    dB: Annotated[float, typer.Option("--dB", help="Noise.")] = 40.0,
    small: Small = False,
    json_file: JsonFile = None,
) -> None:
    """Measure and print."""
    walls, sites = (HIDDEN[:1], SITES[:1]) if small else (HIDDEN, SITES)
    found = [row(site, h, dB, seed) for h in walls for site in sites for seed in range(seeds)]
    columns = ("hidden", "site", "d′", "verdict", "law", "FMU, held out", "held out: law, true", "unseen: law, true")
    lines = []
    for r in found:
        cells = [r["hidden"], r["site"], f"{r['d_prime']:.0f}", r["verdict"], " + ".join(r["law"] or ["–"])]
        if r["law"]:
            cells.append(f"{r['fmu'][0]:.2f} → {r['fmu'][1]:.2f}")
            cells += [f"{a:.2f} → {b:.2f}, {c:.2f}" for a, b, c in (r["held_out"], r["unseen"])]
        lines.append(cells)
    tabulate("gap of what is named → of the learned law, and of the true one", columns, lines)
    near = [r["held_out"][1] <= 1.3 * r["held_out"][2] for r in found if r["law"] and r["d_prime"] >= 30.0]
    seen = sum(r["d_prime"] >= 30.0 for r in found)
    print(f"d′ >= 30: law within 1.3 times the true one's gap in {sum(near)} of {seen} records")
    empty = [null(*each) for each in nulls(null_records)]
    print(f"nulls with a learned law: {sum(r['law'] is not None for r in empty)} of {len(empty)}")
    store(json_file, {"records": found, "nulls": empty})


if __name__ == "__main__":
    start(main)
