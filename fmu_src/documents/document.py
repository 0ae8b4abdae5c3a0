"""What an FMU says about itself to people: ``documentation/index.html``, ``model.png`` and, for FMI 3.0,
``documentation/diagram.png``. Not part of its code."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from solver.laws.outlets import OUTLETS
from solver.network.description import Network
from solver.quantities.units import display_factor

from ..host import PACKAGES, PYTHONS
from ..variables.variable import Variable
from .drawing import model_png, network_svg


def documents(network: Network, table: tuple[Variable, ...], version: str, fmi: int = 0) -> dict[str, bytes]:
    """The files by their path in the FMU. fmi : version of the standard of an FMU that needs no Python, 0 of others."""
    html, png = index_html(network, table, version, fmi), model_png(network)
    drawn = {"model.png": png} | ({"documentation/diagram.png": png} if fmi == 3 else {})  # where FMI 3 looks for it
    return {"documentation/index.html": html.encode(), **drawn, **licences(not fmi)}


def licences(wrapped: bool = True) -> dict[str, bytes]:
    """The licence of this project, where FMI looks for it, and that of pythonfmu, if the FMU carries it."""
    own = Path(__file__).resolve().parents[2] / "LICENSE"
    found = {"documentation/licenses/license.txt": own.read_bytes() if own.is_file() else _licence("arterial-fmu")}
    return found | ({"documentation/licenses/pythonfmu.txt": _licence("pythonfmu")} if wrapped else {})


def _licence(package: str) -> bytes:
    files = distribution(package).files or []
    texts = [f.read_binary() for f in files if f.name.startswith("LICEN")]
    return texts[0] if texts else b"MIT\n"


_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d1f22; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.2rem; } p, ul { max-width: 46rem; }
code { font: 0.88em ui-monospace, monospace; background: #f2f3f5; padding: 0.1em 0.3em; border-radius: 3px; }
figure { margin: 1.5rem 0; } figure svg { max-width: 100%; height: auto; }
figcaption { color: #6b7078; font-size: 0.9em; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.88em; }
th, td { text-align: left; padding: 0.25rem 0.8rem 0.25rem 0; border-bottom: 1px solid #e3e5e8; vertical-align: top; }
td.number { white-space: nowrap; font-variant-numeric: tabular-nums; }
"""

# {drive} is what the host gives, {answer} what it gets back, {letter} and {back} their letters
_USE = """
<h2>How to use it</h2>
<ul>
<li><strong>Inlet.</strong> The input <code>{drive}</code> drives the network, and <code>{answer}</code> answers.{more}
<code>inlet.interpolation</code> says what the input means between two communication points:
<ul>
<li><code>hold</code> (the default): it is kept during the communication step that follows. That acts like a delay of
half a step, and its jumps show in <code>{answer}</code>: use steps of 1 ms or less.</li>
<li><code>linear</code>: it is {letter}(t + h), set before the step from t to t + h, and goes in a straight line from
the value of the step before. That is right, and far more accurate, for a master that knows it; a master that sets
{letter}(t) gets a delay of a whole step.</li>
<li><code>smooth</code>: it is {letter}(t), set before the step from t to t + h, as FMPy, ecos, libcosim and most other
masters do. The FMU extrapolates it over the step, and repeats the step with the straight line when the next value is
there.</li>
</ul></li>
<li><strong>A partner that reads <code>{answer}</code> back</strong> uses the port of the inlet: after the next
communication step, as long as the last one,<br>
{port}<br>
The partner puts this in place of its {back} and solves it together with its own law; then the pair does not ring.
{early} is 0 except with <code>smooth</code>. At an outlet the veins see
P_venous(t + h) = P_0 − Z Q_venous(t + h) with <code>&lt;outlet&gt;.outlet.P_0</code> and <code>.Z</code>. Reading a
port costs one more step; not reading it costs nothing.</li>
<li><strong>Volumes.</strong> <code>network.V</code> is the blood inside, <code>venous.V</code> what has left to the
veins since the start. Partners that exchange counted volumes lose nothing.</li>
<li><strong>Communication steps</strong> may have any length. Each communication step is cut into equal internal steps
of at most 4/3 <code>solver.dt</code>.</li>
<li><strong>Parameters.</strong> Fixed ones are set before initialization ends. Tunable ones may change between steps.
Input pressures (<code>P_venous</code>) are held. Enumerations are set by number.</li>
<li><strong>Signs and units.</strong> Everything is in SI; display units are given beside. Flow counts from the upstream
to the downstream end of a segment. The pressure is the whole one, elastic and viscous.</li>
<li><strong>Start.</strong> With <code>network.start</code> = <code>rest</code> the fluid is at rest under the pressure
<code>network.P_0</code>; a periodic drive needs some beats until the beats repeat. With <code>periodic</code> it starts
{periodic}.</li>
<li><strong>Switch logging on to read error sentences.</strong> A value that is not allowed, or a step that fails, gives
a failed status; the log says in one sentence what was wrong, where and what to do. Without logging the host sees the
status only (FMPy: <code>simulate_fmu(..., debug_logging=True)</code>). When a step fails, FMPy returns a shortened
result without an error: compare the last time with the stop time.</li>
<li><strong>Saved states.</strong> The state can be saved, restored, written as bytes and read again, in this
instance, another one or a new process; what follows is the same to the last bit. Bytes that are damaged or those of
another FMU are rejected. {freed}</li>
<li><strong>Reading it back.</strong> <code>resources/network.toml</code> is the network file that this FMU was built
from, with the values that were set at the build.</li>
</ul>
"""
_DRIVES = {
    "flow": {
        "drive": "inlet.Q",
        "answer": "inlet.P",
        "letter": "Q",
        "back": "pressure",
        "port": "P(t + h) = P_0 + Z_0 Q(t) + Z Q(t + h) with <code>inlet.P_0</code>, <code>inlet.Z_0</code> and "
        "<code>inlet.Z</code>.",
        "early": "Z_0",
        "periodic": "where beats of {shape} with the mean <code>inlet.Q_mean</code> and the period "
        "<code>inlet.T</code> would have led to",
    },
    "pressure": {
        "drive": "inlet.P",
        "answer": "inlet.Q",
        "letter": "P",
        "back": "flow",
        "port": "Q(t + h) = Q_0 + Y_0 P(t) + Y P(t + h) with <code>inlet.Q_0</code>, <code>inlet.Y_0</code> and "
        "<code>inlet.Y</code>.",
        "early": "Y_0",
        "periodic": "in the steady state under the pressure <code>inlet.P_mean</code>",
    },
}

HOST = f"""
<h2>What the host needs</h2>
<ul>
<li>Python {PYTHONS} with {PACKAGES}, and nothing else.</li>
<li>On Linux, hosts that are not Python load libpython first, for example with
<code>LD_PRELOAD=libpython3.11.so.1.0</code> in front of their command. <code>arterial-fmu doctor</code> of
arterial-fmu prints the whole line.</li>
<li>A path of letters, digits, blanks and <code>- . _ ~</code> only where the FMU is unpacked: the wrapper of pythonfmu
crashes on others.</li>
<li>Linux x86-64, where it is tested. The Windows binary is pythonfmu's and untested.</li>
</ul>
"""

_NOTHING = """
<h2>What the host needs</h2>
<p>Nothing: no Python, no other program. Its folder may be unpacked anywhere."""
NATIVE_HOST = f"""{_NOTHING} Of the network it holds one mesh and the
physics that it had when the FMU was built: a length that needs other elements, and a value that switches on what acts
on a part of a segment, are rejected with a sentence. <code>network.start</code> = <code>periodic</code> holds for the
start values in the model description. Directional derivatives are those of the last step.</p>
"""
NATIVE_HOST_OF_FEW = f"{_NOTHING} Directional derivatives are those of the last step.</p>\n"  # of a heart or a body
_CRASHES = """A state that was freed, or is none, crashes the host: the wrapper of pythonfmu does not check
it."""
_REFUSES = "A state that was freed, or is none, is rejected; to another instance it goes as bytes."


def _use(network: Network, fmi: int) -> str:
    words, inlet = _DRIVES[network.inlet.causality], network.inlet
    periodic = words["periodic"].format(shape=inlet.shape)
    further = [f"<code>{each.drive}</code> (answered by <code>{each.answer}</code>)" for each in network.further_inlets]
    if further:
        periodic = (
            "near the beats with the means <code>Q_mean</code> and <code>P_mean</code> of what is given at the inlets"
        )
    more = (
        f" So do the inputs of its further inlets: {', '.join(further)}; what is said here holds for each."
        if further
        else ""
    )
    freed = _REFUSES if fmi else _CRASHES
    return _USE.format_map({**words, "periodic": periodic, "more": more, "freed": freed})


def index_html(network: Network, table: tuple[Variable, ...], version: str, fmi: int = 0) -> str:
    """One self-contained page: what the FMU is, how to use it, its variables, the network drawn, references. fmi : as
    for :func:`documents`."""
    reference = escape(" ".join(network.reference.split()) or "The network file names none.")
    standard = f"FMI {fmi or 2}.0"
    body = f"""<h1>{escape(network.name)}</h1>
<p>Pressure, flow and radius of pulse waves in a network of {_count(network)}, as a co-simulation FMU
({standard}) made by arterial-fmu {escape(version)}. In every artery it solves the one-dimensional equations of mass and
momentum with an elastic or viscoelastic wall; {_outlets_in_words(network)}</p>
<figure>
{network_svg(network)}
<figcaption>Line width grows with the radius R0. Dots are the sites where pressure, flow and radius are reported;
bars are outlets ({", ".join(f"{kind.symbol} {kind.noun}" for kind in OUTLETS)}).</figcaption>
</figure>
{_use(network, fmi)}
{NATIVE_HOST if fmi else HOST}
{variables_html(table)}
<h2>References</h2>
<p>Parameters of the network: {reference}</p>
<p>Model: A. R. Ghigo, X.-F. Wang, R. Armentano, P.-Y. Lagrée, J.-M. Fullana, <em>Linear and nonlinear viscoelastic
arterial wall models: application on animals</em>, Journal of Biomechanical Engineering 139(1), 011003 (2017),
<a href="https://doi.org/10.1115/1.4034832">doi:10.1115/1.4034832</a>.</p>
<p>Licence: MIT.</p>"""
    return page(f"{network.name}: 1D arterial network", body)


def page(title: str, body: str) -> str:
    """A page of HTML."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
{body}
</body>
</html>
"""


def variables_html(table: tuple[Variable, ...]) -> str:
    """Inputs, outputs and parameters as tables, under a heading."""
    groups = [
        (title, [v for v in table if v.causality == causality])
        for title, causality in (("Inputs", "input"), ("Outputs", "output"), ("Parameters", "parameter"))
    ]
    tables = "\n".join(f"<h3>{title}</h3>\n{_table(rows)}" for title, rows in groups)
    return f'<h2>Variables</h2>\n<div class="scroll">\n{tables}\n</div>'


def _count(network: Network) -> str:
    return f"{len(network.segments)} arteries" if len(network.segments) > 1 else "one artery"


def _outlets_in_words(network: Network) -> str:
    kinds = [f"a {kind.noun}" for kind in OUTLETS if kind in {type(outlet) for outlet in network.outlets}]
    return f"every free end has {' or '.join(kinds)} as condition."


def _table(rows: Iterable[Variable]) -> str:
    """A table of variables; outputs have no start values and so no column of them."""
    rows = list(rows)
    starts = any(v.start is not None for v in rows)
    headings = ["Name", "Kind", "Unit", *(["Start"] if starts else []), "Allowed", "Meaning"]
    head = "".join(f"<th>{heading}</th>" for heading in headings)
    return "\n".join(["<table>", f"<tr>{head}</tr>", *(_row(v, starts) for v in rows), "</table>"])


def _row(v: Variable, starts: bool) -> str:
    unit = start = allowed = ""
    if v.quantity is not None:
        q = v.quantity
        unit = "–" if q.unit == "1" else q.unit + (f" ({q.display})" if q.display else "")
        if v.start is not None:
            start = f"{v.start:.6g}"
            if q.display:
                start += f" ({float(v.start) * display_factor(q.display):.5g} {q.display})"
        if np.isfinite(q.high):
            allowed = f"{q.low:g} … {q.high:g}"
        elif np.isfinite(q.low):
            allowed = f"from {q.low:g}"
    else:
        start, allowed = str(v.start), ", ".join(f"{v.number(choice)} {choice}" for choice in v.choices)
    numbers = [unit, *([start] if starts else []), allowed]
    cells = "".join(f"<td class=number>{escape(number)}</td>" for number in numbers)
    return (
        f"<tr><td><code>{escape(v.name)}</code></td><td>{v.variability}</td>{cells}"
        f"<td>{escape(v.description)}</td></tr>"
    )


# --- of a heart or a body -------------------------------------------------------------------------------------------


def lumped_documents(
    name: str, title: str, reference: str, uses: tuple[str, ...], table: tuple[Variable, ...], fmi: int = 0
) -> dict[str, bytes]:
    """The files by their path in the FMU. uses : how to use it, one paragraph each, as HTML. fmi : version of the
    standard of one that needs no Python, 0 of others."""
    points = "\n".join(f"<li>{use}</li>" for use in uses)
    body = f"""<h1>{escape(name)}</h1>
<p>{escape(title)} A co-simulation FMU (FMI {fmi or 2}.0) made by arterial-fmu.</p>
<h2>How to use it</h2>
<ul>
{points}
</ul>
{NATIVE_HOST_OF_FEW if fmi else HOST}
{variables_html(table)}
<h2>References</h2>
<p>{escape(reference)}</p>
<p>Licence: MIT.</p>"""
    html = page(f"{name}: {title}", body)
    return {"documentation/index.html": html.encode(), **licences(not fmi)}


HEART_USES = (
    "<strong>Connect</strong> <code>aorta.Q</code> to <code>inlet.Q</code> of the arteries, and their "
    "<code>inlet.P_0</code>, <code>inlet.Z</code>, <code>inlet.Z_0</code> to <code>aorta.P_0</code>, "
    "<code>aorta.Z</code>, <code>aorta.Z_0</code>. The heart solves its own equations together with this relation, so "
    "the pair is stable at 0.5 to 5 ms, where it was measured, and of second order in the communication step.",
    "<strong>Order.</strong> A master that runs one component after the other runs the heart first and gives its flow "
    "to the arteries before their step, with <code>inlet.interpolation</code> = <code>linear</code>; a master that "
    "runs them side by side sets it to <code>smooth</code>.",
    "<strong>Alone</strong> it fills from a source at <code>venous.P</code> and ejects against "
    "<code>aorta.P_0</code> + <code>aorta.Z_0</code> Q(t) + <code>aorta.Z</code> Q(t + h).",
    "<strong>Nothing received yet.</strong> Some masters set every input to 0 before the first step. Where "
    "<code>aorta.P_0</code>, <code>aorta.Z</code> and <code>aorta.Z_0</code> are all 0 in the first step, the "
    "heart takes its start values.",
    "<strong>Steps</strong> may be up to a twentieth of a beat; one communication step is one implicit step.",
    "<strong>Heart rate and contractility</strong> may change at any time; the phase of the beat goes on from where "
    "it is.",
)
BODY_USES = (
    "<strong>Connect</strong> <code>venous.V</code> of the arteries to <code>arteries.V</code>, <code>venous.V</code> "
    "of the heart to <code>heart.V</code>, and <code>P</code> to <code>venous.P</code> of the heart and to "
    "<code>P_venous</code> of every outlet of the arteries.",
    "<strong>Volume.</strong> The inputs are volumes counted since the start, so nothing is lost between two "
    "communication points.",
    "<strong>Order.</strong> <code>body.exchange</code> = <code>end</code> for a master that runs the body last, "
    "<code>start</code> for one that runs all components side by side.",
)
