"""The report of a study, one for every verdict: what it says, that it needs nothing else, and that a browser runs it.

All outcomes here are synthetic: beats and numbers are made up, so that every part of the page has something to show.
"""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from made_up import LAG, VERDICTS, N, T, isolability, synthetic, write_report

from discrepancy.findings.map_marks import entry, marks
from discrepancy.findings.outcome import (
    Absorbed,
    Detectable,
    Isolability,
    NamedEffect,
    Outcome,
    OwnNumber,
    Walls,
    verdict_json,
)
from discrepancy.report.figures import NAMES
from discrepancy.report.page import page
from discrepancy.report.tables import Z, beats, estimate_text, number, spread_text, wall_rows
from discrepancy.report.verdict_text import not_judged
from fitting.pages import page as shared
from fitting.results.estimate import Estimate
from solver import Network
from solver.quantities.units import MMHG

LIMIT = {"value": 5.0, "unit": "s"}


class Tags(HTMLParser):
    """Checks that tags nest, and collects ids, links and text."""

    VOID = ("meta", "link", "img", "br", "input")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.links += [str(value) for key, value in attrs if key in ("src", "href", "srcset", "action", "data")]
        self.ids += [str(value) for key, value in attrs if key == "id"]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def read(page: Path) -> Tags:
    html = page.read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(html)
    tags.close()
    assert not tags.open
    assert len(set(tags.ids)) == len(tags.ids)
    assert all(link.startswith(("#", "data:")) for link in tags.links)
    assert "@import" not in html and not re.search(r"url\((?!data:)", html) and "<script src" not in html
    return tags


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory, sheep: Network) -> Callable[[str], Path]:
    """The folder of the report of a verdict, written once; those of which only the words are read have no figures."""
    written: dict[str, Path] = {}

    def report(verdict: str) -> Path:
        if verdict not in written:
            written[verdict], outcome = tmp_path_factory.mktemp(verdict), synthetic(verdict, sheep)
            if verdict in ("effect", "none", "unusable"):
                write_report(outcome, written[verdict])
            else:
                (written[verdict] / "report.html").write_text(page(outcome, {}), encoding="utf-8")
        return written[verdict]

    return report


# --- what it says -------------------------------------------------------------------------------------------------

SAID = {
    "none": (
        "No missing effect was found",
        "No place shows a residual beyond noise",
        "Smallest detectable sizes",
        "±2.1 kPa·s",
        "Invisible:",
    ),
    "effect": (
        "One effect is missing",
        "The term added",
        "77.0 kPa·s",
        "71.0 … 83.0",
        "97 %",
        "φ_0 ε̇",
        "3·10⁻¹²",
        "rms before",
        "rms after",
    ),  # fmt: skip
    "ambiguous": (
        "leaves several candidates",
        "The best of the class",
        "channel lag at CA.P",
        "Measure CA.R",
        "3.10 ms",
    ),
    "several": (
        "Several effects are missing",
        "terminal reflection, at FA",
        "0.620",
        "does not rule out the other candidates of the class below",
        "wall viscosity at CA with terminal reflection at FA",
        "wall viscosity at CA with channel lag at CA.P",
    ),
    "partial": (
        "part of the disagreement looks like",
        "Residual: Whitened RMS 3.1",
        "87 %",
        "89 %",
        "of the gap to held-out beats closed",
        "This subject’s walls",
        "CA.E",
        "0.9 MPa",
        "1.20 MPa",
        "1.10 … 1.30",
        "+3.1",
        "beyond",
        "−0.7",
        "E 0.06 (stated 0.08)",
        "33 % above the file's",
        "(calibration)",
        "again with a longer --time-limit",
        "individual",
        "They count as properties of this subject, not as effects",
    ),  # fmt: skip
    "unknown": (
        "is not in the catalogue",
        "acts as a pressure in the wall of CA:",
        "Residual",
        "harmonics 5 to 9",
        "largest at CA.Q",
    ),
    "unusable": ("cannot be used", "Why: CA.P <dead>: it does not change", "Correct the cause", "Line 7 is empty."),
}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_page_says_the_verdict_and_needs_nothing_else(reports: Callable[[str], Path], verdict: str) -> None:
    text = read(reports(verdict) / "report.html").text
    for words in (*SAID[verdict], f"A synthetic outcome of the verdict {verdict}.", "bench/sheep 1.csv"):
        assert words in text, words
    assert "nan" not in text.lower().split() and "None" not in text.split()


def test_unusable_is_short(reports: Callable[[str], Path]) -> None:
    folder = reports("unusable")
    assert not (folder / "figures").exists()
    headings = re.findall("<h2.*?>(.*?)</h2>", (folder / "report.html").read_text(encoding="utf-8"))
    assert headings == ["What this means", "Provenance"]


def test_figures_are_those_on_the_page(reports: Callable[[str], Path]) -> None:
    folder = reports("effect")
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert sorted(p.name for p in folder.iterdir()) == ["figures", "report.html"]
    assert {p.stem for p in (folder / "figures").iterdir()} == set(NAMES)
    for name in NAMES:
        assert base64.b64encode((folder / "figures" / f"{name}.png").read_bytes()).decode() in html


def test_bench_has_no_network(tmp_path: Path, sheep: Network) -> None:
    """A bench record: one site, its radius is not compared; figures of an earlier report go."""
    full = synthetic("several", sheep)
    write_report(replace(full, channels=(), z_map=np.zeros((0, 0)), isolability=None), tmp_path)
    assert {p.stem for p in (tmp_path / "figures").iterdir()} == {"network", "map", "terms"}
    write_report(replace(full, kind="bench", channels=full.channels[3::2], z_map=full.z_map[:, 3:4]), tmp_path)
    assert {p.stem for p in (tmp_path / "figures").iterdir()} == set(NAMES) - {"network", "map", "terms"}
    read(tmp_path / "report.html")


def test_many_labels(tmp_path: Path, sheep: Network) -> None:
    """A sensor set with 150 effects and places, and one with a single one."""
    for n in (150, 1):
        write_report(replace(synthetic("unusable", sheep), kind="bench", isolability=isolability(n)), tmp_path)
        read(tmp_path / "report.html")
        assert (tmp_path / "figures" / "isolability.png").stat().st_size > 1000


def test_nothing_is_written_if_something_fails(tmp_path: Path, sheep: Network) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="is a file, not a folder; give another folder"):
        write_report(synthetic("unusable", sheep), tmp_path / "file")


def test_a_sensor_is_said_to_be_one(tmp_path: Path, sheep: Network) -> None:
    named = {"verdict": "effect", "effects": (LAG,), "members": (((LAG.name, LAG.where),),)}
    (tmp_path / "report.html").write_text(page(replace(synthetic("ambiguous", sheep), **named), {}), encoding="utf-8")
    text = read(tmp_path / "report.html").text
    for words in (
        "A sensor explains the disagreement",
        "not to the arteries",
        "Calibrate or replace that sensor",
        "3.10 ms",
    ):
        assert words in text, words


def part(outcome: Outcome, pattern: str) -> list[str]:
    """Parts of a page as text."""
    return [unescape(found).strip() for found in re.findall(pattern, page(outcome, {}), re.DOTALL)]


def heading(outcome: Outcome) -> str:
    return part(outcome, "<h1>(.*?)</h1>")[0]


def meaning(outcome: Outcome) -> str:
    return part(outcome, "What this means</h2>\n<p>(.*?)</p>")[0]


def next_steps(outcome: Outcome) -> list[str]:
    (steps,) = part(outcome, "<h3>What to [^<]* next</h3>\n<ul>(.*?)</ul>")
    return re.findall("<li>(.*?)</li>", steps)


CLASS = "The class: this record does not distinguish these"


@pytest.mark.parametrize("verdict", ["ambiguous", "several", "partial"])
def test_the_class_is_shown_where_it_leaves_a_choice(sheep: Network, verdict: str) -> None:
    """Each hypothesis is one line with its effects together, in verdict.json one list; alone it is no class."""
    outcome = synthetic(verdict, sheep)
    pair = (("stenosis", ("MD",)), ("channel_gain", ("CA.P",)))
    outcome = replace(outcome, members=((("wall_viscosity", ("CA",)),), pair))
    html = page(outcome, {})
    shown = re.search(rf"<h3>{CLASS}</h3>\s*<ul>(.*?)</ul>", html, re.DOTALL)
    assert shown is not None
    assert re.findall("<li>(.*?)</li>", shown[1]) == [
        "wall viscosity at CA",
        "stenosis at MD with channel gain at CA.P",
    ]
    assert "not distinguishable: wall viscosity at CA; stenosis at MD with channel gain" in outcome._repr_html_()
    assert verdict_json(outcome)["class"] == [
        [{"name": "wall_viscosity", "where": ["CA"]}],
        [{"name": "stenosis", "where": ["MD"]}, {"name": "channel_gain", "where": ["CA.P"]}],
    ]
    alone = replace(outcome, members=(pair,))
    assert CLASS not in page(alone, {}) and "distinguishable" not in alone._repr_html_()


def test_the_class_is_only_spoken_of_where_it_is(sheep: Network) -> None:
    """A partial answer alone in its class has no other; two faults of one site's sensors are no class of two."""
    partial = synthetic("partial", sheep)
    assert "class" not in meaning(partial) and "Another effect" not in meaning(partial)
    several = replace(partial, members=(*partial.members, ((LAG.name, LAG.where),)))
    assert "does not rule out the other candidates of the class below" in meaning(several)
    assert "Another effect" not in meaning(several)
    faults = ((LAG.name, LAG.where), ("catheter_resonance", ("CA.R",)))
    html = page(replace(synthetic("ambiguous", sheep), members=(faults,), separating_measurement=None), {})
    assert "<h1>Two sensor faults at one site explain the record</h1>" in html
    assert "can imitate many other effects" in html and "Calibrate or replace the sensors of that site" in html
    assert "of the class" not in html and CLASS not in html


def test_marks_are_where_the_effect_acts(sheep: Network) -> None:
    """A vessel, a junction of the same name, a sensor's site, and everywhere; named ones apart from possible ones."""

    def placed(verdict: str, *effects: tuple[str, str]) -> list[tuple[str, str, bool]]:
        members = tuple(((name, (place,)),) for name, place in effects)
        named = NamedEffect(effects[0][0], (effects[0][1],), {}, 1.0)
        outcome = Outcome(verdict, "", "", "", "network", effects=(named,), members=members)
        return [(mark.kind, mark.place, mark.named) for mark in marks(outcome)]

    assert placed("effect", ("stenosis", "AA")) == [("segment", "AA", True)]
    assert placed("ambiguous", ("junction_loss", "AA"), ("channel_gain", "CA.P")) == [
        ("junction", "AA", False),
        ("channel", "CA", False),
    ]
    assert placed("effect", ("terminal_reflection", "all")) == [("outlet", "all", True)]
    assert placed("effect", ("fluid_friction", "all")) == [("segment", "all", True)]
    texts = [mark.text for mark in marks(synthetic("several", sheep))]
    assert texts == ["wall viscosity at CA", "terminal reflection at FA", "channel lag at CA.P"]


# --- numbers ------------------------------------------------------------------------------------------------------


def test_numbers_are_read_in_display_units() -> None:
    """By hand: 133.322 Pa are 1 mmHg; digits follow the interval."""
    assert estimate_text("CA.P_ext", Estimate(10 * MMHG, "Pa", (9 * MMHG, 11 * MMHG))) == ("10.0 mmHg", "9.0 … 11.0")
    assert estimate_text("CA.ENL", Estimate(-2e6, "Pa", (-2.5e6, -1.5e6))) == ("−2.00 MPa", "−2.50 … −1.50")
    assert estimate_text("CA.outlet.C", Estimate(7.5006e-9, "m^3/Pa", (7.5e-9, 7.5e-9)))[0] == "1 mL/mmHg"
    precise = Estimate(4.0406761e-3, "m", (4.0406747e-3, 4.0406775e-3))  # half a millionth of a millimetre apart
    assert estimate_text("CA.R0", precise) == ("4.0406761 mm", "4.0406747 … 4.0406775")
    assert estimate_text("CA.E_scale", Estimate(1.3, "1", (-np.inf, np.inf))) == ("1.3", "–")
    assert (number(12345.6), number(-0.5), number(float("nan")), number(1e-9)) == ("12300", "−0.5", "–", "1·10⁻⁹")


def test_classes_of_z() -> None:
    assert [Z.index(z) for z in (0.0, 1.99, 2.0, 63.0, 64.0, 1e9)] == [0, 0, 1, 5, 6, 6]
    assert len(Z.texts) == len(Z.colours)


def test_beats_are_closed_and_in_display_units(sheep: Network) -> None:
    outcome = synthetic("effect", sheep)
    data = beats(outcome)
    first = data["channels"][0]
    assert (first["name"], first["unit"], len(first["measured"])) == ("AA.P", "mmHg", N + 1)
    assert data["time"][-1] == T and first["measured"][0] == first["measured"][-1]
    np.testing.assert_allclose(first["measured"][:-1], outcome.channels[0].measured / MMHG, rtol=1e-5)


# --- in a browser -------------------------------------------------------------------------------------------------

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --disable-component-update "
    "--disable-sync --virtual-time-budget=3000 --enable-logging=stderr --v=0"
).split()
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here (Debian: apt install chromium)")


def browse(folder: Path, profile: Path, *wanted: str, hash_: str = "") -> subprocess.CompletedProcess[str]:
    """Chromium on a report; its console must stay silent."""
    address = (folder / "report.html").as_uri() + hash_
    command = [str(CHROMIUM), *FLAGS, f"--user-data-dir={profile}", *wanted, address]
    environment = {**os.environ, "HOME": str(profile)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
    assert "CONSOLE" not in done.stderr, done.stderr
    return done


@needs_chromium
def test_page_runs_in_a_browser(reports: Callable[[str], Path], tmp_path: Path) -> None:
    """A link to a channel draws its curves, without a word on the console."""
    dom = browse(reports("effect"), tmp_path, "--dump-dom", hash_="#channel=CA.Q&view=difference").stdout
    assert re.findall('data-curve="([a-z]+)"', dom) == ["before", "after"]
    assert 'aria-label="CA.Q, model minus measured: before, after"' in dom
    assert dom.count("<option") == 21


@needs_chromium
def test_page_without_an_addition_runs_in_a_browser(reports: Callable[[str], Path], tmp_path: Path) -> None:
    dom = browse(reports("none"), tmp_path, "--dump-dom").stdout
    assert re.findall('data-curve="([a-z]+)"', dom) == ["measured", "before"]
    assert re.search('<input type="checkbox" id="show-after"[^>]* disabled', dom)


@needs_chromium
def test_nothing_is_cut_at_1100_pixels(sheep: Network, tmp_path: Path) -> None:
    """Two effects with five numbers, 40 harmonics and every wall of the sheep: no part of the page needs scrolling."""
    outcome, numbers = synthetic("ambiguous", sheep), sheep.parameters()
    known = {name: q for name, q in sheep.parameter_quantities().items() if q.individual}
    own = {name: OwnNumber(x, Estimate(x, q.unit, (0.9 * x, 1.1 * x)), 0.4)
           for name, q in known.items() for x in [numbers[name]]}  # fmt: skip
    five = {f"PD.{key}": Estimate(0.235, "1", (0.21, 0.26)) for key in ("K", "K_position", "K_length", "E", "taper_h")}
    pair = replace(outcome.candidates[0], name="nonlinear_wall_viscosity + catheter_resonance", parameters=five)
    z = np.full((41, outcome.z_map.shape[1]), 90.0)
    walls = Walls("individual", {"E": (0.08, 0.06)}, own)
    write_report(replace(outcome, candidates=(pair, *outcome.candidates), z_map=z, walls=walls), tmp_path)
    cut = "[...document.querySelectorAll('.scroll')].filter(e => e.scrollWidth > e.clientWidth + 1 || "
    cut += "e.scrollHeight > e.clientHeight + 1).map(e => e.innerText.slice(0, 40))"
    script = f"<script>document.body.dataset.cut = {cut}.join('|') || 'nothing'</script></body>"
    html = (tmp_path / "report.html").read_text(encoding="utf-8")
    (tmp_path / "report.html").write_text(html.replace("</body>", script), encoding="utf-8")
    dom = browse(tmp_path, tmp_path / "profile", "--window-size=1100,900", "--dump-dom").stdout
    assert re.findall('data-cut="(.*?)"', dom, re.DOTALL) == ["nothing"]


def rows(outcome: Outcome, below: str) -> list[list[str]]:
    """The cells of the table of a page below a heading, row by row."""
    html = page(outcome, {})
    body = re.search(r"<tbody>(.*?)</tbody>", html[html.index(f">{below}</h2>") :], re.DOTALL)
    assert body is not None
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr.*?</tr>", body[1])]


def test_the_best_is_nothing_apart_from_itself(sheep: Network) -> None:
    """Separation: a dash for the best, d' for the others. Where none of them is the verdict, the page says so."""
    outcome = synthetic("none", sheep)
    outcome = replace(outcome, candidates=tuple(replace(c, separation=1.14) for c in outcome.candidates))
    shown = rows(outcome, "Effects that were tried and are not needed")
    assert [row[7] for row in shown] == ["–", "1.14", "1.14"]


def test_candidates_are_named_for_what_they_are(sheep: Network) -> None:
    """Of none they are folded away as not needed, of unknown they explain nothing; neither has a class."""
    none, unknown, effect = (page(synthetic(verdict, sheep), {}) for verdict in ("none", "unknown", "effect"))
    assert "<h2>Effects that were tried and are not needed</h2>\n<details>" in none and "<h2>Candidates" not in none
    assert "No candidate is named." in unknown and "No candidate" not in none + effect
    assert ["in the<br>class" in html for html in (none, unknown, effect)] == [False, False, True]
    assert none.count("<details>") == none.count("</details>") and "<details>\n<summary>3 that" not in unknown + effect


def test_a_search_that_did_not_end_says_nothing_of_the_catalogue(sheep: Network) -> None:
    """Unknown at the time limit: how much of the catalogue was not compared, and more time before any sensor."""
    outcome = replace(synthetic("unknown", sheep), complete=False, provenance={"asked": {"time_limit": LIMIT}})
    assert outcome.isolability is not None
    whole = page(replace(outcome, complete=True), {})
    for false in ("Something is missing that is not in the catalogue", "No effect of the catalogue explains it"):
        assert false in whole and false not in page(outcome, {})
    table = replace(outcome.isolability, labels=(), separation=np.zeros((0, 0)), visibility=np.zeros(0), invisible=())
    nothing = replace(outcome, candidates=(), isolability=replace(table, not_judged=("taper", "stenosis")))
    outlets = replace(outcome, isolability=replace(outcome.isolability, not_judged=("terminal_compliance", "taper")))
    for each, left in (
        (nothing, "none of the 2 effects of the catalogue was compared"),
        (outlets, "1 of the 14 effects of the catalogue was not compared"),  # a taper breaks the model
        (replace(nothing, candidates=outcome.candidates), "not all candidates were compared"),
    ):
        assert heading(each) == "Something is missing, and the time limit ended the search"
        assert f"The search ended at its time limit: {left}." in meaning(each)
        first, second, *_ = next_steps(each)
        assert first == f"Run the study again with a longer --time-limit than 5 s: {left}."
        assert "second, independent sensor" in second


def test_only_a_whole_search_rules_out(sheep: Network) -> None:
    """One effect at the time limit: the others were not all refitted."""
    outcome = synthetic("effect", sheep)
    assert "Every other candidate was ruled out" in meaning(outcome)
    cut = meaning(replace(outcome, complete=False))
    assert "ruled out" not in cut and "Another effect may also explain it." in cut


def test_unknown_has_no_name_to_be_sure_of(sheep: Network) -> None:
    """Its confidence, which is of what comes nearest, is in verdict.json alone."""
    outcome = replace(synthetic("unknown", sheep), confidence=0.83)
    html = page(outcome, {})
    assert "confidence in the name" not in html and "83 %" not in html and "83 %" not in outcome._repr_html_()
    assert verdict_json(outcome)["confidence"] == 0.83
    assert "confidence in the name" in page(synthetic("effect", sheep), {})


def test_what_remains_says_what_it_is_counted_over(sheep: Network) -> None:
    """An RMS of the fit is no gap; a reason without one says nothing of it."""
    outcome = synthetic("unknown", sheep)
    rms = replace(outcome, reason="whitened RMS 1.3 (1.8 up to the third harmonic)")
    said = "whitened RMS 1.3 (1.8 up to the third harmonic) (over all fitted data; 1 is noise)</p>"
    assert said in page(rms, {}) and "all data that were fitted" not in page(outcome, {})


def test_an_unknown_gap_in_the_means_sends_to_the_sensors(sheep: Network) -> None:
    """The channel, by how much and on which side; not where the waveform differs more than its mean."""
    outcome = synthetic("unknown", sheep)
    wave = np.linspace(-1.0, 1.0, len(outcome.channels[0].measured))  # variance 1/3
    channels = [replace(c, before=c.measured + 100.0 * wave, after=None) for c in outcome.channels]
    assert "in the mean of" not in page(replace(outcome, channels=tuple(channels)), {})
    pressure = next(i for i, c in enumerate(channels) if c.name.endswith(".P"))
    channels[pressure] = replace(channels[pressure], before=channels[pressure].before - 1.4 * MMHG)
    name = channels[pressure].name
    said = f"in the mean of {name} (1.4 mmHg above the model’s): check the zeros and heights of the sensors"
    assert said in page(replace(outcome, channels=tuple(channels)), {})


def test_the_file_and_this_animal_have_gaps_of_two_names(sheep: Network) -> None:
    """The gap of the file as it is, in the provenance; the one before has this animal's walls."""
    outcome = replace(synthetic("effect", sheep), provenance={"gap_as_given": {"fit": 9.9, "held_out": 8.8}})
    html = page(outcome, {})
    assert "<dt>gap of the file as it is</dt>" in html and "gap before: this subject’s walls, no effect" in html
    assert "model as given" not in html


def test_parameters_are_described(sheep: Network) -> None:
    """By the catalogue, with nothing as the unit of a number without one; the equation names no place of its own."""
    numbers = {"PD.K": Estimate(9.9, "1", (9.5, 10.3)), "PD.K_position": Estimate(0.235, "1", (0.21, 0.26))}
    stenosis = NamedEffect("stenosis", ("PD",), numbers, 0.9, entry("stenosis").equation)
    html = page(replace(synthetic("effect", sheep), effects=(stenosis,)), {})
    for cell in ("loss coefficient K", "middle of the part as a fraction of the segment from its upstream end"):
        assert f'<td class="text">{cell}</td>' in html
    assert "<td>0.235</td>" in html and "over a part of the segment</p>" in html and "middle tenth" not in html


def test_walls_without_differences(sheep: Network) -> None:
    """All spreads 0: in words. Else of which number the spread is a part, and of which it is absolute."""
    outcome = synthetic("partial", sheep)
    assert outcome.walls is not None
    both = replace(outcome, walls=replace(outcome.walls, spread={"E": (0.08, 0.06), "R_t": (0.03, 0.01)}))
    assert spread_text(both) == (
        "Standard deviations between arteries, relative, absolute for R_t: E 0.06 (stated 0.08); R_t 0.01 "
        "(stated 0.03)."
    )
    same = replace(outcome, walls=replace(outcome.walls, spread={"E": (0.08, 0.0)}))
    assert spread_text(same) == "Beyond the common changes, the arteries do not differ."


def test_walls_are_told_to_what_they_are_known_to(sheep: Network) -> None:
    """By hand, R0 of 9.48 mm: where no differences were found, to a tenth of the stated spread of 0.02, 0.019 mm;
    else to two digits of half the interval."""
    own = {"AA.R0": OwnNumber(9.48e-3, Estimate(9.479992e-3, "m", (9.47997e-3, 9.48001e-3)), 0.0)}
    told = []
    for found in (0.0, 0.01):
        outcome = replace(synthetic("none", sheep), walls=Walls("individual", {"R0": (0.02, found)}, own))
        (row,) = wall_rows(outcome)
        told.append((row["file"], row["value"], row["interval"]))
    assert told == [("9.48 mm", "9.480 mm", "–"), ("9.48 mm", "9.479992 mm", "9.479970 … 9.480010")]


def test_why_walls_are_as_they_are(sheep: Network) -> None:
    """What was asked for is told apart from what the record says."""
    cut, common = synthetic("partial", sheep), synthetic("none", sheep)
    individual = replace(cut, complete=True)
    for outcome, asked, said in (
        (individual, {"walls": "by evidence"}, "the record is more probable with individual walls"),
        (cut, {"walls": "by evidence"}, "the time limit ended the search before the record could decide"),
        (individual, {"walls": "individual"}, "set by --walls individual"),
        (individual, {"walls": "individual", "prior": {"file": "monday.json"}}, "calibrated in monday.json"),
        (common, {"walls": "by evidence"}, "the record gives no evidence for individual walls"),
        (common, {"walls": "common"}, "set by --walls common"),
    ):
        assert f": {said}." in page(replace(outcome, provenance={"asked": asked}), {})


def test_long_odds_are_not_counted(sheep: Network) -> None:
    """-2 ln odds of 7e7 are as good as 1001."""
    outcome = synthetic("effect", sheep)
    outcome = replace(
        outcome, candidates=tuple(replace(outcome.candidates[0], behind=each) for each in (210.0, 1000.0, 7.11e7))
    )
    assert [row[4] for row in rows(outcome, "Candidates")] == ["210", "1000", "&gt; 1000"]


def test_what_all_have_in_common_is_a_factor(sheep: Network) -> None:
    """ln 1.2 = 0.182 of a scale is a factor of 1.2; a shift is none."""
    free = Absorbed("all.outlet.P_venous of A", -190.0, 210.0, 0.0, "Pa")
    absorbed = (Absorbed("ln all.E", 0.18232, 0.01, 0.2), Absorbed("all.outlet.R_t", 0.1, 0.01, 0.2), free)
    shown = rows(replace(synthetic("none", sheep), absorbed=absorbed), "Changes common to all arteries")
    assert [row[-1] for row in shown] == ["× 1.2", "–", "–"]
    assert [row[2] for row in shown] == ["0 ± 0.2", "0 ± 0.2", "none"] and not free.far


def test_what_is_not_a_number(sheep: Network, tmp_path: Path) -> None:
    """A hypothesis that held-out beats cannot be simulated with has no gap there, and a channel may have none: null in
    verdict.json, a dash on the page."""
    outcome = synthetic("effect", sheep)
    lost = replace(outcome.candidates[2], held_out=np.nan)
    channel = replace(outcome.channels[0], gap_before=(1.2, np.nan))
    outcome = replace(outcome, candidates=(lost,), channels=(channel, *outcome.channels[1:]), gap_after=(1.0, np.inf))
    content = json.loads(json.dumps(verdict_json(outcome), allow_nan=False))
    assert content["gap"]["after"] == {"fit": 1.0, "held_out": None}
    said = content["gap"]["channels"]["AA.P"]
    assert (said["before"], said["after"], said["unit"]) == (None, 1.04, "Pa") and said["rms_before"] > 0.0
    assert rows(outcome, "Candidates")[0][6] == rows(outcome, "Gap of every channel")[0][3] == "–"


def test_where_it_comes_from_is_read_with_units() -> None:
    """A number with its unit is one word."""
    asked = {"walls": "by evidence", "time_limit": {"value": 300.0, "unit": "s"}}
    assert shared.words(asked) == "walls: by evidence; time limit: 300 s"


def test_smallest_changes_are_read_in_display_units(sheep: Network) -> None:
    """By hand: a part of a factor in per cent; 1 ms of φNL/φ0; a shift of one sign; 1 µs² as 1/ω_n² are 159 Hz;
    one that shows at no size that it may have. verdict.json has the plain numbers, null where there is none."""
    found = {
        "wall_stiffness at AA": Detectable("AA.E_scale", 0.0013, "1", relative=True, either=True),
        "nonlinear_wall_viscosity at all": Detectable("all.phiNL", 1e-3, "s", either=True, ratio="phi0"),
        "external_pressure at PD": Detectable("PD.P_ext", -2.0 * MMHG, "Pa"),
        "channel_offset at CA.R": Detectable("CA.R.offset", 2.8e-6, "m", either=True),
        "catheter_resonance at BT.Q": Detectable("BT.Q.resonance", 1e-6, "s^2"),
        "junction_loss at all": Detectable("all.k", np.nan, "1"),
    }
    outcome = replace(synthetic("none", sheep), smallest=found)
    assert [tuple(row) for row in rows(outcome, "Smallest detectable sizes")] == [
        ("wall stiffness at AA", "AA.E_scale", "±0.13 %"),
        ("nonlinear wall viscosity at all places", "all.phiNL / phi0", "±1 ms"),
        ("external pressure at PD", "PD.P_ext", "−2 mmHg"),
        ("channel offset at CA.R", "CA.R.offset", "±0.0028 mm"),
        ("catheter resonance at BT.Q", "BT.Q.resonance", "f_n = 159 Hz, zeta = 0"),
        ("junction loss at all places", "all.k", "not detectable in its allowed range"),
    ]
    told = verdict_json(outcome)["smallest_detectable"]
    assert told["junction_loss at all"]["change"] is None
    assert (told["wall_stiffness at AA"]["change"], told["wall_stiffness at AA"]["relative"]) == (0.0013, True)


def test_rivals_are_marked_as_they_are_told(sheep: Network) -> None:
    """a cannot be told from b, b from a can: the row of a alone is marked. d is invisible: no rival, and nobody's."""
    separation = np.array([[0, 2, 50, 1], [20, 0, 40, 1], [50, 40, 0, 1], [1, 1, 1, 0]], float)
    table = Isolability(("a", "b", "c", "d"), separation, np.array([20.0, 30.0, 60.0, 1.0]), ("d",))
    outcome = replace(synthetic("none", sheep), isolability=table)
    assert [row[2:] for row in rows(outcome, "Effects that these sensors can distinguish")] == [
        ["b", "2", "b"],
        ["a", "20", "–"],
        ["b", "40", "–"],
        ["–", "–", "invisible"],
    ]
    marked = re.findall(r'<tr class="chosen"><td>([abcd])</td>', page(outcome, {}))
    assert marked == ["a", "d"]


def test_why_effects_were_not_judged(sheep: Network) -> None:
    """An outlet of another kind; this animal's walls, where each differs; the time limit; a model that breaks down."""
    outcome = replace(synthetic("partial", sheep), effects=(), members=())
    assert outcome.isolability is not None and outcome.walls is not None
    table = replace(outcome.isolability, not_judged=("wall_viscosity", "terminal_compliance", "stenosis"))
    animal, outlet, broken = not_judged(replace(outcome, complete=True, isolability=table)).items()
    assert animal[1] == "wall viscosity" and "a property of this subject" in animal[0]
    assert outlet[1] == "terminal compliance" and "another kind of outlet" in outlet[0]
    assert broken == ("the simulation fails with it", "stenosis")
    common = replace(outcome, walls=Walls(), isolability=table)
    assert not_judged(common)["the simulation fails with it"] == "wall viscosity, stenosis"
    none = replace(table, labels=(), separation=np.zeros((0, 0)), visibility=np.zeros(0), invisible=())
    assert not_judged(replace(common, isolability=none))[
        "not simulated within the time limit"] == "wall viscosity, stenosis"  # fmt: skip


def test_what_was_named_was_judged(sheep: Network) -> None:
    """A stiff part of a segment is named where every artery differs, or is in the class: page and verdict.json do not
    say that wall stiffness was not judged. The viscosity of all, which was not named, remains."""
    outcome = synthetic("partial", sheep)
    assert outcome.isolability is not None
    stiff = NamedEffect("wall_stiffness", ("CA",), {}, 0.9)
    table = replace(outcome.isolability, not_judged=("wall_stiffness", "wall_viscosity"))
    outcome = replace(outcome, isolability=table, effects=(), members=())
    label = ("wall_stiffness", ("CA",))
    assert list(not_judged(replace(outcome, complete=True)).values()) == ["wall stiffness, wall viscosity"]
    for named in (
        replace(outcome, effects=(stiff,), members=((label,),)),
        replace(outcome, members=((("stenosis", ("MD",)),), (("stenosis", ("BT",)), label))),
    ):
        assert list(not_judged(replace(named, complete=True)).values()) == ["wall viscosity"]
        assert verdict_json(named)["not_judged"] == ["wall_viscosity"]


def test_what_was_not_judged_and_the_global_test_are_said(sheep: Network) -> None:
    """Another kind of outlet has no place among the invisible; the p-value of the global χ² stands under the z map."""
    outcome = synthetic("ambiguous", sheep)
    assert outcome.isolability is not None
    table = replace(outcome.isolability, not_judged=("terminal_compliance",))
    html = page(replace(outcome, isolability=table, p_value=0.0), {})
    assert "<b>Not judged:</b> terminal compliance (another kind of outlet" in html and "χ² has p &lt; 10⁻¹⁶" in html
    assert "χ² has p = 0.032" in page(replace(outcome, p_value=0.0321), {})
    content = verdict_json(replace(outcome, isolability=table, p_value=0.0321))
    assert (content["not_judged"], content["global_p_value"]) == (["terminal_compliance"], 0.0321)
