"""A closed loop of three FMUs: a heart, the human arteries and the veins, at 120/80 mmHg.

    python examples/closed_loop.py [--out dist]

Builds the three FMUs and runs them one after the other with FMPy: the heart first, which solves its own equations with
the port of the arteries, then the arteries with the flow that it found, then the veins. Then it halves the
communication step, with the port and with the usual exchange of flow and pressure, and draws everything.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import fmpy
import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from arterial_fmu.cli.terminal.console import sentences
from arterial_fmu.cli.terminal.progress import bar
from build_fmu import build_model
from fitting.pages.style import png
from fmu_src.contents.models import arteries_model, body_model, heart_model, of
from fmu_src.contents.system import start_values
from fmu_src.cosimulation.ports import INLET_PORTS
from fmu_src.importer.unpacking import unpacking_folder
from solver import Settings, load
from solver.io.writing import check_destinations, write_folder
from solver.quantities.units import MMHG

Array = np.ndarray
Records = dict[str, Array]

BEATS = 12
STEP = 1e-3  # s, communication step
STUDY = 0.5  # s, from the start: filling ends, the ventricle ejects, the aortic valve closes
STEPS = (4e-3, 2e-3, 1e-3, 5e-4)
REFERENCE = 6.25e-5  # s
FINE = 2.5e-4  # s, internal step of the arteries meanwhile
ML = 1e-6
SITES = {"AsA": "ascending aorta", "TA1": "thoracic aorta", "AB1": "abdominal aorta", "RI": "right iliac"}
# blue, vermilion, bluish green and reddish purple of Okabe and Ito, which colour-blind readers can distinguish
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")


class Component:
    """An instance of an FMU, with its variables by name."""

    def __init__(self, fmu: Path, folder: str) -> None:
        description = fmpy.read_model_description(str(fmu))
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(fmu), folder), description, "CoSimulation")

    def __getitem__(self, name: str) -> float:
        return float(self.fmu.getReal([self.references[name]])[0])

    def set(self, values: Mapping[str, float]) -> None:
        """Set numbers by name."""
        self.fmu.setReal([self.references[name] for name in values], list(values.values()))

    def begin(self, values: Mapping[str, float]) -> None:
        """Initialize with start values."""
        self.fmu.setupExperiment(startTime=0.0)
        self.set(values)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def step(self, t: float, h: float, values: Mapping[str, float]) -> None:
        """Advance from t to t + h with these inputs."""
        self.set(values)
        self.fmu.doStep(t, h)


@contextmanager
def components(fmus: Mapping[str, Path]) -> Iterator[dict[str, Component]]:
    """Instances of FMUs by name, freed at the end."""
    with ExitStack() as stack:
        made = {}
        for name, fmu in fmus.items():
            made[name] = Component(fmu, stack.enter_context(unpacking_folder("loop_")))
            stack.callback(made[name].fmu.freeInstance)
        yield made


def run(
    fmus: Mapping[str, Path],
    h: float,
    stop_time: float,
    names: Mapping[str, tuple[str, ...]],
    *,
    port: bool = True,
    dt: float = STEP,
    progress: Callable[[float], None] = lambda part: None,
) -> Records:
    """The loop with communication steps of h [s]: "time" and ``<component>.<name>`` : (n + 1,).

    port : whether the heart solves P = P_0 + Z Q with the arteries, or takes their pressure as it was.
    dt : the arteries' internal time step [s].
    """
    n = round(stop_time / h)
    with components(fmus) as parts:
        heart, arteries, body = parts["heart"], parts["arteries"], parts["body"]
        heart.begin({})
        arteries.begin({"solver.dt": dt})
        body.begin({})
        veins = [name for name in arteries.references if name.endswith(".P_venous")]
        rows = []
        for i in range(n + 1):
            rows.append([parts[part][name] for part, each in names.items() for name in each])
            if i == n:
                break
            t = i * h
            if port:
                load = {f"aorta.{key}": arteries[f"inlet.{key}"] for key in INLET_PORTS["flow"]}
            else:
                load = {"aorta.P_0": arteries["inlet.P"], "aorta.Z": 0.0, "aorta.Z_0": 0.0}
            heart.step(t, h, {**load, "venous.P": body["P"]})
            arteries.step(t, h, {"inlet.Q": heart["aorta.Q"], **dict.fromkeys(veins, body["P"])})
            body.step(t, h, {"arteries.V": arteries["venous.V"], "heart.V": heart["venous.V"]})
            progress((i + 1) / n)
    columns = [f"{part}.{name}" for part, each in names.items() for name in each]
    return {"time": np.arange(n + 1) * h, **dict(zip(columns, np.array(rows).T, strict=True))}


def build(out: Path) -> dict[str, Path]:
    """The three FMUs in ``out``, with the start values of the loop: not those of build_fmu.py."""
    network = load("human")
    starts = start_values(network, *of("human"), parallel=False)
    models = {
        "heart": heart_model("human", starts["heart"]),
        "arteries": arteries_model(network, Settings(), starts["arteries"]),
        "body": body_model("human", starts["body"]),
    }
    return {name: build_model(model, out) for name, model in models.items()}


SHOWN = {
    "heart": (
        "left_ventricle.P", "left_ventricle.V", "left_atrium.P", "left_atrium.V", "aorta.P", "aorta.Q",
    ),
    "arteries": ("inlet.P", "network.V", *(f"{site}.P" for site in SITES)),
    "body": ("P", "V"),
}  # fmt: skip
VOLUMES = ("heart.left_ventricle.V", "heart.left_atrium.V", "arteries.network.V", "body.V")
STUDIED = {"heart": ("aorta.Q",), "arteries": ("AsA.Q", "AB1.P")}


def study(fmus: Mapping[str, Path], progress: Callable[[float], None]) -> dict[bool, Array]:
    """Relative errors at STEPS : (steps, quantities), with the port (True) and without, against a run at REFERENCE."""
    every = [(REFERENCE, True), *((h, port) for port in (True, False) for h in STEPS)]
    work = np.cumsum([1.0 / h + 2.0 / FINE for h, _ in every])
    found = {}
    for i, (h, port) in enumerate(every):
        found[h, port] = run(fmus, h, STUDY, STUDIED, port=port, dt=min(h, FINE))
        progress(work[i] / work[-1])
    reference = found[REFERENCE, True]

    def errors(h: float, port: bool) -> list[float]:
        every = round(h / REFERENCE)
        return [
            float(np.linalg.norm(found[h, port][name] - values[::every]) / np.linalg.norm(values[::every] - values[0]))
            for name, values in reference.items()
            if name != "time"
        ]

    return {port: np.array([errors(h, port) for h in STEPS]) for port in (True, False)}


# --- what is shown ------------------------------------------------------------------------------------------------


def beat_table(records: Records, n: int) -> Table:
    """The last beat, n steps long, in clinical terms, and the loss of volume."""
    beat = {name: values[-n - 1 :] for name, values in records.items()}
    before = {name: values[-2 * n - 1 : -n] for name, values in records.items()}
    V = beat["heart.left_ventricle.V"]
    stroke = np.ptp(V)
    total = np.sum([records[name] for name in VOLUMES], axis=0)[::n]
    P = beat["arteries.AsA.P"] / MMHG
    repeats = max(np.ptp(beat[name] - before[name]) / np.ptp(beat[name]) for name in SHOWN_PRESSURES)
    table = Table(title=f"Beat {BEATS} of the closed loop")
    table.add_column("")
    table.add_column("", justify="right")
    for what, value in (
        ("pressure in the ascending aorta", f"{P.max():.1f}/{P.min():.1f} mmHg"),
        ("stroke volume", f"{stroke / ML:.1f} mL of {V.max() / ML:.1f} mL"),
        ("cardiac output", f"{60e3 * stroke / (n * STEP):.2f} L/min"),
        ("largest flow in the aorta", f"{beat['heart.aorta.Q'].max() / ML:.0f} mL/s"),
        ("filling pressure", f"{beat['body.P'].mean() / MMHG:.1f} mmHg"),
        ("difference from the beat before", f"{repeats:.0e} of the pulse"),
        ("volume lost in a beat, at most", f"{np.abs(np.diff(total)).max() / stroke:.0e} of the stroke volume"),
    ):
        table.add_row(what, value)
    return table


SHOWN_PRESSURES = tuple(f"arteries.{site}.P" for site in SITES)
QUANTITIES = ("flow from the heart", "flow, ascending aorta", "pressure, abdominal aorta")
MARKS = "osv"


def order_table(errors: Mapping[bool, Array]) -> Table:
    """Errors and orders at the communication steps."""
    table = Table(title="Error against the communication step")
    table.add_column("quantity")
    for heading in ("step, ms", "with Z", "order", "exchanged", "order"):
        table.add_column(heading, justify="right")
    for j, quantity in enumerate(QUANTITIES):
        for i, h in enumerate(STEPS):
            cells = []
            for port in (True, False):
                e = errors[port][:, j]
                cells += [f"{e[i]:.1e}", f"{np.log2(e[i - 1] / e[i]):.2f}" if i else ""]
            table.add_row(quantity if i == 0 else "", f"{1e3 * h:g}", *cells, end_section=i + 1 == len(STEPS))
    return table


def draw(records: Records, n: int, errors: Mapping[bool, Array]) -> Figure:
    """The pressure-volume loop, the pressures of the heart, the pulse along the aorta, and the order."""
    figure = Figure(figsize=(10.0, 7.2), layout="constrained")
    (loop, heart), (wave, order) = figure.subplots(2, 2)
    beat = {name: values[-n - 1 :] for name, values in records.items()}
    t = beat["time"] - beat["time"][0]
    for k in range(BEATS):
        part = slice(k * n, (k + 1) * n + 1)
        last = k == BEATS - 1
        style = {"color": COLOURS[0], "linewidth": 2.0} if last else {"color": "0.75", "linewidth": 0.8}
        V, P = records["heart.left_ventricle.V"][part] / ML, records["heart.left_ventricle.P"][part] / MMHG
        loop.plot(V, P, **style, label={0: "from the start on", BEATS - 1: f"beat {BEATS}"}.get(k))
    _label(loop, "Left ventricle", "volume [mL]", "pressure [mmHg]")
    for (name, text), colour in zip(
        {"left_ventricle.P": "left ventricle", "aorta.P": "aorta", "left_atrium.P": "left atrium"}.items(),
        COLOURS,
        strict=False,
    ):
        heart.plot(t, beat[f"heart.{name}"] / MMHG, color=colour, label=text)
    _label(heart, "Heart", "time [s]", "pressure [mmHg]")
    flow = heart.twinx()
    flow.plot(t, beat["heart.aorta.Q"] / ML, color="0.55", linestyle="--", linewidth=1.2)
    flow.set_ylabel("flow into the aorta, dashed [mL/s]")
    flow.set_ylim(-300.0, 1200.0)
    flow.spines["top"].set_visible(False)
    for (site, text), colour in zip(SITES.items(), COLOURS, strict=True):
        wave.plot(t, beat[f"arteries.{site}.P"] / MMHG, color=colour, label=f"{text} ({site})")
    _label(wave, "Pulse along the aorta", "time [s]", "pressure [mmHg]")
    steps = 1e3 * np.array(STEPS)
    for port, colour, slope in ((True, COLOURS[0], 2), (False, COLOURS[1], 1)):
        for j, mark in enumerate(MARKS):
            order.loglog(steps, errors[port][:, j], mark + "-", color=colour, markersize=5)
        line = 0.5 * errors[port][0].min() * (steps / steps[0]) ** slope
        order.loglog(steps, line, ":", color="0.4", linewidth=1.2)
        order.annotate(f"order {slope}", (1.05 * steps[-1], 0.4 * line[-1]), fontsize=9, color="0.3")
    for colour, text in ((COLOURS[1], "flow and pressure exchanged"), (COLOURS[0], "with Z and P_0")):
        order.plot([], [], color=colour, label=text)
    for mark, quantity in zip(MARKS, QUANTITIES, strict=True):
        order.plot([], [], mark, color="0.3", markersize=5, label=quantity)
    order.set_ylim(bottom=0.02 * errors[True].min())  # room for the legend
    order.set_xticks(steps, [f"{h:g}" for h in steps])
    order.minorticks_off()
    _label(order, "Error against the communication step", "communication step [ms]", "relative error")
    return figure


def _label(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=11)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color="0.92", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines["top"].set_visible(False)
    axes.spines["right"].set_visible(False)
    axes.legend(frameon=False, fontsize=8)


# --- the example --------------------------------------------------------------------------------------------------


def main(
    out: Annotated[Path, typer.Option(help="Directory of the figure.")] = Path("dist"),
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Run heart, arteries and veins in a closed loop until the beats repeat, and show that the coupling converges."""
    console, began = Console(), time.perf_counter()
    picture = out / "closed_loop.png"
    with sentences(ValueError), TemporaryDirectory(prefix="loop_") as folder:
        check_destinations(picture, folders=True)  # before a minute of work, not after it
        fmus = build(Path(folder))
        n = round(load("human").inlet.T / STEP)
        with bar(quiet) as progress:
            records = run(
                fmus, STEP, BEATS * n * STEP, SHOWN, progress=lambda part: progress(0.5 * part, f"{BEATS} beats")
            )
            errors = study(fmus, lambda part: progress(0.5 + 0.5 * part, "order of convergence"))
        write_folder(out, {picture.name: png(draw(records, n, errors), 150)})
    console.print(beat_table(records, n))
    console.print(order_table(errors))
    console.print(f"figure   {picture}", markup=False)
    console.print(f"The example took {time.perf_counter() - began:.0f} s.")


if __name__ == "__main__":
    typer.run(main)
