"""What an FMU says about itself to people: ``documentation/index.html`` and ``model.png``. Not part of its code."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape
from importlib.metadata import distribution
from pathlib import Path

import numpy as np

from solver.network import Network
from solver.outlets import OUTLETS
from solver.units import display_factor

from .drawing import model_png, network_svg
from .variable import Variable


def documents(network: Network, table: tuple[Variable, ...], version: str) -> dict[str, bytes]:
    """The files by their path in the FMU."""
    return {
        "documentation/index.html": index_html(network, table, version).encode(),
        "model.png": model_png(network),
        **licences(),
    }


def licences() -> dict[str, bytes]:
    """The licence of this project, where FMI looks for it, and that of pythonfmu, which every FMU carries."""
    own = Path(__file__).resolve().parent.parent / "LICENSE"
    return {
        "documentation/licenses/license.txt": own.read_bytes() if own.is_file() else _licence("arterial-fmu"),
        "documentation/licenses/pythonfmu.txt": _licence("pythonfmu"),
    }


def _licence(package: str) -> bytes:
    files = distribution(package).files or []
    texts = [f.read_binary() for f in files if f.name.startswith("LICEN")]
    return texts[0] if texts else b"MIT\n"


_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d1f22; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; }
h1, h2 { line-height: 1.2; } h2 { margin-top: 2.2rem; } p, ul { max-width: 46rem; }
code { font: 0.88em ui-monospace, monospace; background: #f2f3f5; padding: 0.1em 0.3em; border-radius: 3px; }
figure { margin: 1.5rem 0; overflow-x: auto; } figcaption { color: #6b7078; font-size: 0.9em; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: 0.88em; }
th, td { text-align: left; padding: 0.25rem 0.8rem 0.25rem 0; border-bottom: 1px solid #e3e5e8; vertical-align: top; }
td.number { white-space: nowrap; font-variant-numeric: tabular-nums; }
"""

_USE = """
<h2>How to use it</h2>
<ul>
<li><strong>Inlet.</strong> The input <code>inlet.Q</code> drives the network. With
<code>inlet.interpolation</code> = <code>hold</code> its value is kept during a communication step. That acts like a
delay of half a step, and its jumps show in the pressure at the inlet: use steps of 1 ms or less. With
<code>linear</code> the inflow goes in a straight line from the value of the step before to the present one. That is
right, and far more accurate, for a master that sets Q(t + h) before the step from t to t + h; a master that sets Q(t)
gets a delay of a whole step.</li>
<li><strong>Communication steps</strong> may have any length. Inside, the FMU steps on its own grid of
<code>solver.dt</code>; between grid points the outputs come from a short step that is then discarded.</li>
<li><strong>Parameters.</strong> Fixed ones are set before initialization ends. Tunable ones may change between steps.
Input pressures (<code>P_venous</code>) are held.</li>
<li><strong>Signs and units.</strong> Everything is in SI; display units are given beside. Flow counts from the upstream
to the downstream end of a segment. The pressure is the whole one, elastic and viscous.</li>
<li><strong>Start.</strong> The fluid is at rest under the pressure <code>network.P_0</code>; a periodic inflow needs a
few beats until the beats repeat.</li>
<li><strong>Switch logging on to read error sentences.</strong> A value that is not allowed, or a step that fails, gives
a failed status; the log says in one sentence what was wrong, where and what to do. Without logging the host sees the
status only (FMPy: <code>simulate_fmu(..., debug_logging=True)</code>). When a step fails, FMPy returns a shortened
result without an error: compare the last time with the stop time.</li>
<li><strong>Saved states.</strong> The state can be saved, restored, written as bytes and read again, in this
instance, another one or a new process; what follows is the same to the last bit. Bytes that are damaged or those of
another FMU are refused. A state that was freed, or is none, crashes the host: the wrapper of pythonfmu does not check
it.</li>
<li><strong>Reading it back.</strong> <code>resources/network.toml</code> is the network file of this FMU.</li>
</ul>
<h2>What the host needs</h2>
<ul>
<li>Python 3.10 to 3.13 with numpy, and nothing else.</li>
<li>On Linux, hosts that are not Python load libpython first, for example with
<code>LD_PRELOAD=libpython3.11.so.1.0</code> in front of their command.</li>
<li>A path without <code>(</code>, <code>+</code> or non-ASCII characters where the FMU is unpacked: the wrapper of
pythonfmu crashes on them.</li>
<li>Linux x86-64, where it is tested. The Windows binary is pythonfmu's and untested.</li>
</ul>
"""


def index_html(network: Network, table: tuple[Variable, ...], version: str) -> str:
    """One self-contained page: what the FMU is, how to use it, its variables, the network drawn, references."""
    reference = escape(" ".join(network.reference.split()) or "The network file names none.")
    body = f"""<h1>{escape(network.name)}</h1>
<p>Pressure, flow and radius of pulse waves in a network of {_count(network)}, as a co-simulation FMU
(FMI 2.0) made by arterial-fmu {escape(version)}. In every artery it solves the one-dimensional equations of mass and
momentum with an elastic or viscoelastic wall; {_outlets_in_words(network)}</p>
<figure>
{network_svg(network)}
<figcaption>Line width grows with the radius R0. Dots are the sites where pressure, flow and radius are reported;
bars are outlets ({", ".join(f"{kind.symbol} {kind.noun}" for kind in OUTLETS)}).</figcaption>
</figure>
{_USE.replace("inlet.Q", network.inlet.drive)}
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
    head = "<tr><th>Name</th><th>Kind</th><th>Unit</th><th>Start</th><th>Allowed</th><th>Meaning</th></tr>"
    return "\n".join(["<table>", head, *(_row(v) for v in rows), "</table>"])


def _row(v: Variable) -> str:
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
    cells = (
        f"<td><code>{escape(v.name)}</code></td><td>{v.variability}</td><td class=number>{escape(unit)}</td>"
        f"<td class=number>{escape(start)}</td><td class=number>{escape(allowed)}</td><td>{escape(v.description)}</td>"
    )
    return f"<tr>{cells}</tr>"
