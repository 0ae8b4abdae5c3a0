"""The page of the FMU of a heart or a body. Not part of its code."""

from __future__ import annotations

from html import escape

from ..variables.variable import Variable
from .document import HOST, NATIVE_HOST_OF_FEW, licences, page, variables_html


def documents(
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
