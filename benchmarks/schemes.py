"""Work and precision of the schemes on the paper's sheep network: a table, and docs/images/schemes.png.

    python benchmarks/schemes.py [--rows FILE] [--figure FILE] [--small]

Error of the fifth beat from rest (relative L2, pressures by their mean-removed norm) against the reference waveforms in
tests/data, and CPU time of a beat, one thread. FILE stores the measurements, so that a run can be resumed.
"""

from __future__ import annotations

import csv
import time
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import typer

from benchmarks.table import Small, continued, start, tabulate
from solver import MusclSettings, Settings, Waveforms, load, simulate

ROOT = Path(__file__).resolve().parents[1]
FOUR = ("MD.P", "MD.Q", "CA.P", "CA.Q")
BEATS = 5
CELLS = (20.0, 10.0, 5.0, 2.5, 1.25)  # mm
WALLS = {"viscoelastic": "sheep_kelvin_voigt", "elastic": "sheep_elastic"}
LINES = {  # label, colour (Okabe and Ito's), marker, line
    "default": ("default scheme", "#000000", "o", "-"),
    "coupled": ("MUSCL, coupled ends", "#0072B2", "s", "--"),
    "neumann": ("MUSCL, neumann ends", "#D55E00", "^", ":"),
    "neumann, central slopes": ("MUSCL, neumann ends, central slopes", "#009E73", "v", ":"),
}
OTHER_SLOPES = ("monotonized central", "central")
DEFAULTS = {
    "viscoelastic": [Settings(dt=5e-3, tolerance=1e-3), Settings(dt=2.5e-3), Settings(), Settings(dt=5e-4)],
    "elastic": [Settings(dt=2.5e-3), Settings(), Settings(5e-4, 0.025, 3), Settings(5e-4, 0.0125, 4)],
}


def cases() -> dict[tuple[str, str, str], Settings | MusclSettings]:
    """The settings by line, wall and name. In elastic walls both kinds of ends are the same to the last bit."""
    found: list[tuple[str, str, Any]] = [("default", wall, s) for wall in WALLS for s in DEFAULTS[wall]]
    for cell in (1e-3 * cell for cell in CELLS):
        found += [(ends, "viscoelastic", MusclSettings(cell=cell, ends=ends)) for ends in ("coupled", "neumann")]
        found.append(("coupled", "elastic", MusclSettings(cell=cell)))
        for slopes in OTHER_SLOPES:
            settings = MusclSettings(cell=cell, ends="neumann", slopes=slopes)
            found.append((f"neumann, {slopes} slopes", "viscoelastic", settings))
            found.append((f"coupled, {slopes} slopes", "elastic", MusclSettings(cell=cell, slopes=slopes)))
    return {(line, wall, name_of(settings)): settings for line, wall, settings in found}


def name_of(settings: Settings | MusclSettings) -> str:
    """The settings that differ, as the table shows them."""
    if isinstance(settings, MusclSettings):
        return f"cells of {1e3 * settings.cell:g} mm"
    return f"dt {1e3 * settings.dt:g} ms, {1e2 * settings.element_length:g} cm, degree {settings.degree}"


def errors(result: Waveforms, file: str) -> dict[str, float]:
    """Error of every channel over the last beat, at the times that it shares with the reference, 1 ms apart."""
    with (ROOT / "tests" / "data" / f"{file}.csv").open() as stream:
        rows = list(csv.reader(stream))
    table, found = np.array(rows[1:], float), {}
    dt = result.time[1]
    own = len(result.time) - 1 - round(0.5 / dt) + np.arange(round(0.5 / dt))
    at = (own - own[0]) * dt / 1e-3
    whole = np.isclose(at, np.round(at))
    for i, title in enumerate(rows[0]):
        name = title.split(" ")[0]
        if name in result and name not in ("time", "inlet.Q"):
            expected = table[np.round(at[whole]).astype(int), i]
            scale = expected if name.endswith("Q") else expected - expected.mean()
            found[name] = float(np.linalg.norm(result[name][own[whole]] - expected) / np.linalg.norm(scale))
    return found


def measured(line: str, wall: str, settings: str) -> dict[str, Any]:
    """One row: what was run, its errors, and the CPU time of a beat [s]."""
    sheep, chosen = load("sheep"), cases()[line, wall, settings]
    parameters = {f"{s.name}.phi0": 0.0 for s in sheep.segments} if wall == "elastic" else None
    scheme, start = "staggered" if line == "default" else "muscl", time.process_time()
    result = simulate(sheep, duration=0.5 * BEATS, parameters=parameters, settings=chosen, scheme=scheme)
    seconds, every = (time.process_time() - start) / BEATS, errors(result, WALLS[wall])
    PQ = {name: error for name, error in every.items() if name[-1] in "PQ" and not name.startswith("inlet")}
    worst = max(PQ, key=lambda name: PQ[name])
    return {
        "line": line, "wall": wall, "settings": settings, "seconds": seconds,
        **{name: every[name] for name in FOUR}, "worst": PQ[worst], "where": worst, "every": PQ,
    }  # fmt: skip


def sites(rows: list[dict[str, Any]]) -> None:
    """All ten sites with the shortest cells."""
    own = [row for row in rows if row["settings"] == name_of(MusclSettings(cell=1e-3 * CELLS[-1])) and "every" in row]
    cells = [(name, *(f"{row['every'][name]:.1e}" for row in own)) for name in (own[0]["every"] if own else ())]
    tabulate("", ("site", *(f"{row['line']}, {row['wall']}" for row in own)), cells)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Error at the paper's two sites against CPU time, one panel a wall."""
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.8), sharex=True, sharey=True, layout="constrained")
    for panel, wall in zip(panels, WALLS, strict=True):
        for line, (label, colour, marker, style) in LINES.items():
            own = [row for row in rows if (row["line"], row["wall"]) == (line, wall)]
            if own:
                x, y = [row["seconds"] for row in own], [max(row[name] for name in FOUR) for row in own]
                label = label if wall == "viscoelastic" or line == "default" else "MUSCL, either ends"
                panel.loglog(x, y, color=colour, marker=marker, linestyle=style, markersize=5, label=label)
        panel.set(title=f"{wall} walls", xlabel="CPU time of a beat [s]")
        panel.grid(which="major", alpha=0.3)
        panel.legend(frameon=False, fontsize=9)
    panels[0].set_ylabel("largest relative error of P and Q\nat MD and CA [–]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)


def main(
    rows: Annotated[Path, typer.Option(help="What was measured; made, and continued.")] = Path("build/schemes.json"),
    figure: Annotated[Path, typer.Option(help="The figure to write.")] = ROOT / "docs" / "images" / "schemes.png",
    small: Small = False,
) -> None:
    """Measure the missing cases, print the table and draw the figure."""
    every = cases()
    coarsest = {key[:2]: key for key in reversed(every)}.values()
    found = continued(rows, ("line", "wall", "settings"), coarsest if small else every, measured)
    found.sort(key=lambda row: list(every).index((row["line"], row["wall"], row["settings"])))
    lines = sorted(found, key=lambda row: (row["wall"] == "elastic", row["line"]))
    cells = [
        (row["line"], row["wall"], row["settings"], f"{row['seconds']:.2f}", *(f"{row[name]:.1e}" for name in FOUR),
         f"{row['worst']:.1e} {row['where']}")
        for row in lines
    ]  # fmt: skip
    tabulate("", ("scheme", "walls", "settings", "CPU s a beat", *FOUR, "ten sites"), cells, left=3)
    sites(found)
    draw(found, figure)


if __name__ == "__main__":
    start(main)
