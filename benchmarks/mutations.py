"""Faults put into a copy of the tree one at a time: the named tests of the fast suite must catch each.

    python benchmarks/mutations.py [NUMBER ...]   # all, or some, by their numbers; exit code 1 if any is missed

Each is one small error in a wall law, a junction, an outlet, an evidence, a verdict or the variables of an FMU: a sign,
a factor 2, a missing term, another unit, a threshold. Only the test files that are named with it are run.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
NOT_COPIED = shutil.ignore_patterns(
    ".git", ".venv", "build", "dist", ".*_cache", ".hypothesis", "__pycache__", "images"
)


class Fault(NamedTuple):
    """``old`` stands once in ``file`` and becomes ``new``; tests : of the fast suite, without ``tests/test_``."""

    what: str
    file: str
    old: str
    new: str
    tests: str


WALL, LAWS, OUTLETS = "solver/laws/wall.py", "solver/laws/wall_laws.py", "solver/laws/outlets.py"
EVIDENCE, SCORING = "fitting/inference/hierarchy.py", "discrepancy/name/scoring.py"
VERDICT, TABLE = "discrepancy/name/verdict.py", "fmu_src/variables/arteries_variables.py"

FAULTS = (
    Fault("β-law: half the slope of E_NL", LAWS, "(1.0 + 2.0 * e * (s - 1.0))", "(1.0 + e * (s - 1.0))", "wall"),
    Fault("regression law: without 1/s", LAWS, "(1.0 + e * strain)) / s", "(1.0 + e * strain))", "wall"),
    Fault("viscosity: twice as large", WALL, "self.phi0 * self.K_h / 2.0", "self.phi0 * self.K_h", "wall"),
    Fault("viscous slope: wrong sign", WALL, "slope = -nu_s * A_t / A", "slope = nu_s * A_t / A", "wall"),
    Fault("memory: slope of twice its past", WALL, "slope -= 0.5 * self.K_h", "slope -= 1.0 * self.K_h", "wall"),
    Fault("memory: an unknown past is the present", WALL, "weights(self.elements[0], _USUAL) * now", "now", "wall"),
    Fault("monotone law: another series near 0", LAWS, "8.0 / 15.0", "8.0 / 12.0", "wall"),
    Fault("strain rate: half", WALL, "A_t / (2.0 * np.sqrt(A", "A_t / (4.0 * np.sqrt(A", "wall"),
    Fault("junction: loss gained", "solver/scheme/model.py", "(c.alpha - c.k)", "(c.alpha + c.k)", "junctions"),
    Fault("junction: kinetic pressure with the wrong sign", "solver/scheme/terms.py",
          "flux += s.model.end_kinetic", "flux -= s.model.end_kinetic", "junctions"),
    Fault("junction: pressures of the other ends", "solver/scheme/stage.py",
          "products = np.stack([-by_left[..., 0], -by_right[..., 0], by_left[..., 1]",
          "products = np.stack([-by_left[..., 0], -by_left[..., 1], by_right[..., 0]",
          "pressure_inlet.py::test_jacobian_of_the_nodes"),  # others never end
    Fault("junction: half the slope of the kinetic pressure", "solver/scheme/terms.py",
          "by_U = 2.0 * s.model.end_kinetic", "by_U = 1.0 * s.model.end_kinetic", "terms"),
    Fault("reflection: R_t with the other sign", OUTLETS, '(1.0 - numbers["R_t"]) / (1.0 + numbers["R_t"])',
          '(1.0 + numbers["R_t"]) / (1.0 - numbers["R_t"])', "linear"),
    Fault("Windkessel: never empties", OUTLETS, "(1.0 + store / numbers", "(1.0 + 0.0 * store / numbers", "outlets"),
    Fault("Windkessel: flow to the veins by the sum of pressures", OUTLETS,
          '(P_C - numbers["P_venous"]) / numbers["R2"]', '(P_C + numbers["P_venous"]) / numbers["R2"]', "ports"),
    Fault("Windkessel: half the compliance for small waves", OUTLETS, "1j * omega[:, None] * C * R2",
          "0.5j * omega[:, None] * C * R2", "linear"),
    Fault("Windkessel: half of the venous pressure", OUTLETS, 'give=charge / numbers["R2"]', "give=0.5 - 0.5 * keep",
          "outlets"),
    Fault("reflection: velocity and wave speed subtracted", OUTLETS, "wall.riemann_velocity(A) + wall.wave_speed(A)",
          "wall.riemann_velocity(A) - wall.wave_speed(A)", "outlets"),
    Fault("leak at an outlet: slope of another unit", OUTLETS, "self.slope(P) + self.scale * outflow(P)[1]",
          "self.slope(P) + outflow(P)[1]", "outlets"),
    Fault("evidence: half the volume of the posterior", EVIDENCE, "axis=1) + volume", "axis=1) + 0.5 * volume",
          "hierarchy"),
    Fault("evidence: ln 2π of sizes with the wrong sign", EVIDENCE, "- len(ends) * math.log", "+ len(ends) * math.log",
          "hierarchy"),
    Fault("evidence: tails of priors added", EVIDENCE, "- float(local[plain] @ x[plain] ** 2)",
          "+ float(local[plain] @ x[plain] ** 2)", "hierarchy"),
    Fault("evidence: a fixed size without the 2 of 2π", EVIDENCE, "LOG_RANGE / math.sqrt(2.0 * math.pi))",
          "LOG_RANGE / math.sqrt(math.pi))", "hierarchy"),
    Fault("prior: deviations cheaper than none", EVIDENCE, "DOUBT) ** 2 - 2.0 * math.log(1.0 - COMMON)",
          "DOUBT) ** 2 + 2.0 * math.log(1.0 - COMMON)", "hierarchy"),
    Fault("prior: the width of an outlier is free", EVIDENCE, "return 2.0 * math.log(len(APART))", "return 0.0",
          "hierarchy"),
    Fault("prior: half the price of many candidates", SCORING, "return 2.0 * math.log(max(len(effects)",
          "return 1.0 * math.log(max(len(effects)", "comparing"),
    Fault("hypothesis: all explain", SCORING, "return self.misfit < (", "return self.misfit > (", "comparing"),
    Fault("verdict: a name needs nine tenths", VERDICT, "if named > 0.5 else", "if named > 0.9 else", "comparing"),
    Fault("verdict: a class of one", VERDICT, "< at.RULED_OUT:", "< 0.0 * at.RULED_OUT:", "comparing"),
    Fault("verdict: a quarter of the gap closed for a half", VERDICT, "math.sqrt(n.fit.chi2 / found.none.fit.chi2)",
          "n.fit.chi2 / found.none.fit.chi2", "comparing"),
    Fault("verdict: members of a pair not weighed alone", VERDICT, "for n in single[at.FEW :] if n.label in alone",
          "for n in single[at.FEW :] if n.label not in alone and not n.label", "comparing"),
    Fault("verdict: of a network what closes less than half", VERDICT, "_closed(found, n) >= at.PART_CLOSED",
          "_closed(found, n) < at.PART_CLOSED", "comparing"),
    Fault("verdict: ambiguous for several", VERDICT, "if _of_one_site(best, network) else",
          "if not _of_one_site(best, network) else", "comparing"),
    Fault("FMU: a pressure inlet starts at 0", TABLE, '{"Q": 0.0, "P": P_0}[kind]', '{"Q": 0.0, "P": 0.0}[kind]',
          "pressure_inlet.py::test_a_host_that_sets_nothing_has_arteries_at_rest"),
    Fault("FMU: the mean of the file's pressure ignored", TABLE,
          "network.P_0 if each.P_mean is None else each.P_mean", "network.P_0", "pressure_inlet"),
    Fault("FMU: admittance of a port in another unit", TABLE, '"Y": Quantity("m^3/(Pa.s)"', '"Y": Quantity("m^3/Pa"',
          "pressure_inlet"),
    Fault("FMU: a volume of nothing", TABLE, 'if name == "network.V" else ()', 'if name != "network.V" else ()',
          "fmu_description"),
    Fault("FMU: numbers of the starts swapped", TABLE, 'STARTS = ("rest", "periodic")', 'STARTS = ("periodic", "rest")',
          "readme.py::test_numbers_of_choices"),
    Fault("FMU: radii in mm", TABLE, 'Quantity("m", "radius"', 'Quantity("mm", "radius"', "fmu_description"),
    Fault("FMU: geometry is tunable, walls are not", TABLE, 'kind = "tunable" if quantity.tunable',
          'kind = "fixed" if quantity.tunable', "fmu_description"),
    Fault("FMU: steps and elements swapped", TABLE, '{"solver.dt": settings.dt, "solver.element_length": settings.el',
          '{"solver.element_length": settings.dt, "solver.dt": settings.el', "fmu_description"),
)  # fmt: skip


# a fault of the same length within the same second would run the module as it was compiled without it
_ANEW = {"PYTHONDONTWRITEBYTECODE": "1"}


def caught(fault: Fault, tree: Path) -> str:
    """The test that fails with the fault, "" where none does. Raises ValueError where the fault cannot be put in, and
    where its tests do not run."""
    path = tree / fault.file
    whole = path.read_text(encoding="utf-8")
    if whole.count(fault.old) != 1:
        raise ValueError(f"{fault.file}: {fault.old!r} stands {whole.count(fault.old)} times in it; mend the fault.")
    path.write_text(whole.replace(fault.old, fault.new), encoding="utf-8")
    try:
        return first_failure(fault.tests, tree)
    finally:
        path.write_text(whole, encoding="utf-8")


def first_failure(tests: str, tree: Path) -> str:
    """The first of a fault's tests that fails, "" where all pass. Raises ValueError where they do not run."""
    files = [f"tests/test_{name}" if "::" in name else f"tests/test_{name}.py" for name in tests.split()]
    line = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider", *files]
    done = subprocess.run(
        [*line, "-m", "not slow and not deep and not endurance"],
        cwd=tree, env={**os.environ, "PYTHONPATH": str(tree), **_ANEW}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if done.returncode == 0:
        return ""
    failed = [text for text in done.stdout.splitlines() if text.startswith(("FAILED", "ERROR"))]
    if done.returncode != 1 or not failed:
        raise ValueError(f"{tests}: pytest ended with {done.returncode}.\n{done.stdout}{done.stderr}")
    return failed[0].partition(" tests/")[2].partition(" - ")[0]


def main() -> None:
    """Each fault, and the test that catches it."""
    numbers = [int(text) for text in sys.argv[1:]] or range(1, len(FAULTS) + 1)
    missed = []
    with tempfile.TemporaryDirectory(prefix="arterial_faults_") as folder:
        tree = Path(folder) / "tree"
        shutil.copytree(ROOT, tree, ignore=NOT_COPIED)
        for tests in dict.fromkeys(FAULTS[number - 1].tests for number in numbers):
            if failed := first_failure(tests, tree):
                raise ValueError(f"{failed} fails without a fault; mend it first.")
        for number in numbers:
            fault, before = FAULTS[number - 1], resource.getrusage(resource.RUSAGE_CHILDREN)
            test = caught(fault, tree)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
            print(f"{number:2d} {fault.what}: {test or 'MISSED'} ({seconds:.0f} s)", flush=True)
            missed += [] if test else [number]
    raise SystemExit(1 if missed else 0)


if __name__ == "__main__":
    main()
