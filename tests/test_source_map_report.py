"""The source map in the report: harmonics as beats, places in words and units, verdict.json, the page, the journal.

The maps are made up; the records are those of a small network, or of none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forked import NETWORK, T, clean, record
from made_up import synthetic
from test_confirm import named, stiffer, study

from discrepancy.assemble import ValidationRuns, _acting, sentence, summary
from discrepancy.checkpoint import Journal
from discrepancy.findings.outcome import Outcome, verdict_json
from discrepancy.findings.shown_map import Acting, SourceMapShown, band_of, beat_of, shown_map
from discrepancy.name.scoring import Named
from discrepancy.name.verdict import Naming
from discrepancy.report.figures import figures, mark
from discrepancy.report.page import page
from discrepancy.report.verdict_text import acts_as, map_sentences
from discrepancy.show.fmu_validation import Gap
from fitting.inference.fit import Fit
from fitting.inference.joint.joint_record import Several
from fitting.inference.models.network_record import network_problem
from fitting.inference.places import Place, places
from fitting.inference.source_maps.source_evidence import Normal
from fitting.inference.source_maps.source_map import Rival, Signal, SourceMap
from fitting.inference.unknown import Unknown
from solver.quantities.units import MMHG

Array = np.ndarray

K = 6
PROBLEM = network_problem(record(clean()), NETWORK).individual()
UNKNOWNS = PROBLEM.hypothesis(())
PLACES = places(NETWORK, ("B.P", "B.Q", "C.R"), UNKNOWNS)
ML = 1e-6  # m³


def place(kind: str, name: str, at: float | None = None) -> Place:
    """The last of these: of drops in a segment without x/L, both halves."""
    return [p for p in PLACES if p.key == (kind, name, at)][-1]


def signal(where: Place, *amplitudes: float, sd: float = 0.0) -> Signal:
    """a cos(2πt/T) of every source of a place [SI]."""
    g = np.zeros((K + 1, where.columns), complex)
    g[1] = np.array(amplitudes) / 2.0 if amplitudes else 0.0
    return Signal(where, g, np.full(g.shape, sd))


def found(
    *signals: Signal, rivals: Sequence[Rival] = (), chi2: float = 100.0, x: dict[str, float] | None = None
) -> SourceMap:
    """A map of 100 data. x : by variable, of the numbers that stand out."""
    apart = {s.place.unknown.name for s in signals if s.place.unknown is not None}
    unknowns = tuple(u.set_apart() if u.name in apart else u for u in UNKNOWNS)
    at = np.array([(x or {}).get(u.variables[0], 0.0) if u.group else 0.0 for u in unknowns])
    return SourceMap(signals, unknowns, at, 321.0, chi2, 100, tuple(rivals), np.zeros((K + 1, 3, len(at))))


def shown(*signals: Signal, shares: Sequence[float] = (), **more: object) -> SourceMapShown:
    return shown_map(found(*signals, **more), NETWORK, record(clean()), shares)  # type: ignore[arg-type]


LEAK = signal(place("outflow", "B"), -2.0 * ML)
SQUEEZED = signal(place("wall", "C"), 1.0 * MMHG, -3.0 * MMHG, 0.5 * MMHG, sd=0.1 * MMHG)
MADE: Outcome = replace(synthetic("unknown", NETWORK), map=None)
NO_OTHERS: dict[str, Any] = {"channels": (), "z_map": np.zeros((0, 0)), "isolability": None}  # figures but the map


# --- beats --------------------------------------------------------------------------------------------------------


def test_harmonics_become_the_beat() -> None:
    """Against the sum term by term; the mean is real."""
    rng = np.random.default_rng(3)
    g = rng.normal(size=(K + 1, 2)) + 1j * rng.normal(size=(K + 1, 2))
    time = np.array([0.0, 0.07, 0.31])
    waves = [[2.0 * (g[k] * np.exp(2j * np.pi * k * t / T)).real for k in range(1, K + 1)] for t in time]
    expected = [g[0].real + sum(each) for each in waves]
    assert beat_of(g, time, T) == pytest.approx(np.array(expected), rel=1e-12)


def test_the_band_is_that_of_the_noise() -> None:
    """A source that one channel shows as it is, with anything allowed beforehand: known as well as the channel, whose
    beat has the variance S_0 + 2 Σ S_k of its coefficients' S = E|x|². And by 20 000 draws of the harmonics."""
    S = np.array([4.0, 9.0, 1.0, 0.25])
    whitener, ones = 1.0 / np.sqrt(S)[:, None, None], np.ones((4, 1, 1))
    normal = Normal.of(whitener, np.zeros((4, 1)), np.zeros((4, 1, 0)), ones)
    sd = normal.amplitudes(np.array([0]), np.full((4, 1), 1e12), np.zeros(0))[1]
    band = band_of(sd, 5)
    assert band == pytest.approx(np.full((5, 1), math.sqrt(4.0 + 2.0 * (9.0 + 1.0 + 0.25))), rel=1e-6)
    rng = np.random.default_rng(1)
    draws = sd * (rng.normal(size=(4, 20000)) + 1j * rng.normal(size=(4, 20000)))
    assert beat_of(draws, np.array([0.1]), T).std() == pytest.approx(band[0, 0], rel=0.02)


def test_of_several_sources_the_largest_is_shown() -> None:
    """The pressure that rises linearly along C; its band is sqrt(1 + 4 K) times 0.1 mmHg."""
    (wall,) = shown(SQUEEZED).acting
    assert (wall.sources, wall.part, wall.unit) == (3, "linear along C", "Pa")
    assert wall.mean == pytest.approx(-3.0 * MMHG * np.cos(2.0 * np.pi * shown(SQUEEZED).time / T))
    assert wall.band == pytest.approx(0.1 * MMHG * math.sqrt(1.0 + 4.0 * K))
    halves = shown(signal(place("drop", "A"), 1.0, 2.0)).acting[0]
    junction = shown(signal(place("junction", "A"), 5.0, 1.0, 2.0)).acting[0]
    everywhere = shown(signal(place("drop", "all"), 5.0, 1.0, 9.0)).acting[0]
    assert halves.part == "between x/L = 0.5 and 1 of A"
    assert (junction.part, everywhere.part) == ("between A and the junction", "along C")


def test_a_number_is_told_beside_the_others_and_the_file() -> None:
    """All moduli 1.1 times the file's, that of B 1.5 times these; a reflection that is 0.2 more."""
    one, other = place("number", "B.E"), place("number", "C.outlet.R_t")
    assert one.unknown is not None and other.unknown is not None
    x = {"B.E": math.log(1.5) / one.unknown.size, "C.outlet.R_t": 0.2 / other.unknown.size}
    made = found(signal(one), signal(other), x=x)
    common = next(u for u in made.unknowns if u.name == "all.E")
    at = np.where([u is common for u in made.unknowns], math.log(1.1) / common.size, made.x)
    E, R = shown_map(replace(made, x=at), NETWORK, record(clean())).acting
    assert E.number is not None and R.number is not None
    assert (E.unit, E.number.factor, E.number.file) == ("Pa", True, 9e5)
    assert (E.number.beyond, E.number.value) == (pytest.approx(1.5), pytest.approx(1.5 * 1.1 * 9e5))
    assert (R.number.factor, R.number.beyond, R.number.value) == (False, pytest.approx(0.2), pytest.approx(0.4))
    text = acts_as(shown_map(replace(made, x=at), NETWORK, record(clean())))
    assert "B.E is an outlier: 1.49 MPa, 1.5 times the value expected from the others (the file has 0.9 MPa)." in text
    assert "C.outlet.R_t is an outlier: 0.4, 0.2 above the value expected from the others (the file has 0.2)." in text


# --- words --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (LEAK, "a loss of flow along B: 1.4 mL/s rms ("),
        (signal(place("drop", "A", 0.3), 2.0 * MMHG), "a drop of pressure in A at x/L = 0.3: 1.4 mmHg rms ("),
        (signal(place("outlet", "C"), 1.0 * ML), "an additional flow through the outlet of C: 0.71 mL/s rms ("),
        (signal(place("junction", "A"), MMHG, 0, 0), "a drop of pressure at junction A: 0.71 mmHg rms ("),
        (signal(place("channel", "C.R"), 1e-5), "an additional signal of the sensor of C.R: 0.0071 mm rms ("),
        (signal(place("channel", "inlet.Q"), ML), "an additional signal of the sensor of inlet.Q: 0.71 mL/s rms ("),
        (SQUEEZED, "a pressure in the wall of C: 2.1 mmHg rms ("),
        (signal(place("wall", "all"), *[MMHG] * 9), "a pressure in all walls: 0.71 mmHg rms, uniform along A ("),
    ],
)  # fmt: skip
def test_what_acts_is_said_with_its_size(made: Signal, said: str) -> None:
    """An RMS of a/√2, in the unit that people read, and as a part of the pulse where that was measured."""
    assert acts_as(shown(made)).startswith(f"It acts as {said}")


def test_size_as_a_part_of_the_pulse_and_time() -> None:
    """Of the flow measured in B; a cosine of negative sign is largest at 0, one that never moves has no such time."""
    (leak,) = shown(LEAK).acting
    assert (leak.channel, leak.pulse) == ("B.Q", pytest.approx(np.ptp(clean()["B.Q"])))
    part = 100.0 * math.sqrt(2.0) * ML / np.ptp(clean()["B.Q"])
    assert f"1.4 mL/s rms ({part:.2g} % of the pulse of B.Q), largest at 0 s, " in acts_as(shown(LEAK))
    assert "diastole; 40 % of the gap (χ²)." in acts_as(shown(LEAK, shares=(0.4,)))
    steady = replace(LEAK, g=np.where(np.arange(K + 1)[:, None] == 0, 3.0 * ML, 0.1 * LEAK.g))
    assert acts_as(shown(steady)).endswith("nearly constant over the beat.")


def test_rivals_are_what_stands_in_the_place_of_one() -> None:
    """9 above: cannot be told; 11 above: it can. Without it, and with one place more, which is no rival."""
    wall, leak, outlet = SQUEEZED.place, LEAK.place, place("outlet", "B")
    rivals = [
        Rival((wall, outlet), 3.0),
        Rival((wall, leak, place("wall", "A")), 4.0),
        Rival((leak,), 9.0),
        Rival((place("drop", "C", 0.5), leak), 11.0),
    ]
    squeezed, leaking = shown(SQUEEZED, LEAK, rivals=rivals).acting
    assert [(tuple(p.label for p in r.places), r.above) for r in leaking.rivals] == [(("the outlet of B",), 3.0)]
    assert [(tuple(p.label for p in r.places), r.above) for r in squeezed.rivals] == [((), 9.0)]
    text = acts_as(shown(SQUEEZED, LEAK, rivals=rivals))
    assert "cannot distinguish a loss of flow along B from an additional flow through the outlet of B." in text
    assert "Without a pressure in the wall of C, the record is nearly as probable: the other places and" in text
    many = [Rival((p,), 1.0) for p in PLACES if p.kind == "drop"][:6]
    assert "x/L = 0.5 or 3 other places." in acts_as(shown(LEAK, rivals=many))
    assert "x/L = 0.5 or 1 other place." in acts_as(shown(LEAK, rivals=many[:4]))


def test_the_map_of_one_of_several_recordings_says_which() -> None:
    """Several recordings have the map of the first, and its sentences name it."""
    rivals = [Rival((place("outlet", "B"),), 3.0), Rival((), 4.0)]
    text = acts_as(replace(shown(LEAK, rivals=rivals), recording="rest"))
    assert text.startswith("In rest it acts as a loss of flow along B: ")
    assert "rest cannot distinguish it from an additional flow" in text
    assert text.endswith("Without it, rest is nearly as probable: refitted walls take its part.")
    assert map_sentences(replace(shown(LEAK), recording="rest"))[0].startswith("In rest the missing physics acts as")
    labels = ("rest", "pacing")
    naming = replace(named("unknown"), map=found(LEAK), problem=Several((PROBLEM, PROBLEM), labels))
    acting = _acting(study(), naming)
    assert acting is not None and acting.recording == "rest"
    alone = _acting(study(), replace(naming, problem=PROBLEM))
    assert alone is not None and alone.recording == ""


@pytest.mark.parametrize(
    ("signals", "chi2", "said"),
    [
        ((), 142.0, "No place shows a residual beyond noise"),
        ((), 143.0, "The residual exceeds the noise, but no place explains it: χ² is 1.43 per datum."),
        ((LEAK,), 90.0, "With these terms, only noise remains: χ² is 0.9 per datum."),
        ((LEAK,), 300.0, "With these terms, more than noise remains: χ² is 3 per datum."),
    ],
)
def test_what_is_left_is_said(signals: tuple[Signal, ...], chi2: float, said: str) -> None:
    """100 data: noise stays below 100 + 3 √200 = 142.4."""
    text = " ".join(map_sentences(shown(*signals, chi2=chi2)))
    assert said in text and text.startswith("The missing physics acts" if signals else ("No place", "The residual"))


def nothing() -> Named:
    none = np.zeros(0)
    return Named(Fit((), (), none, none, np.zeros((0, 0)), np.zeros(0, int), np.zeros(0, int)), 0.0, 9.0)


@pytest.mark.parametrize("complete", [True, False])
def test_an_unknown_law_is_told_by_place_and_shape(complete: bool) -> None:
    """The verdict's sentence; without a map, or with an empty one, as before."""
    naming = Naming("unknown", PROBLEM, nothing(), (), (), {}, (), 0.5, "RMS 3", complete)
    gap = Gap((9.0, 9.3), {})
    said = sentence(naming, (), gap, None, shown(LEAK))
    tried = "No law of the catalogue explains it." if complete else "No law was compared with it."
    begun = f"Something is missing: the gap to held-out beats is 9.3 times the noise. {tried} It acts as a loss of flow"
    assert said.startswith(begun) and ("The time limit ended the search" in said) != complete
    assert sentence(naming, (), gap, None, shown()) == sentence(naming, (), gap, None)
    partial = sentence(replace(naming, verdict="partial"), (), gap, gap, shown(LEAK))
    assert "but more than noise remains, and it may stand for branches or other physics that the model lacks" in partial
    assert "lacks. All missing physics together acts as a loss of flow along B" in partial


def test_the_outcome_has_the_map_of_its_naming() -> None:
    """From the naming of a small network on: sentence, verdict.json and page, with beats of the study's period."""
    s = study()
    run = stiffer(s, 0.0)
    naming = replace(named("unknown"), map=found(LEAK), base=replace(named().base, misfit=9.0), complete=True)
    outcome = summary("fork.toml", s, naming, ValidationRuns(run, run))
    assert outcome.map is not None and outcome.map.T == T
    assert "No law of the catalogue explains it. It acts as a loss of flow along B: 1.4 mL/s rms (" in outcome.sentence
    assert verdict_json(outcome)["map"][0]["where"] == "B" and "Where the missing physics acts" in page(outcome, {})
    assert page(outcome, {}).count("cts as a loss of flow along B") == 1  # the section has the sentence's map as figure
    assert summary("", s, replace(naming, map=None), ValidationRuns(run, run)).map is None


# --- verdict.json, figure and page --------------------------------------------------------------------------------


def test_verdict_json_has_the_places() -> None:
    """RMS in SI; a number has its value and the file's; null where no map was made."""
    rivals = [Rival((place("outlet", "B"),), 3.0)]
    content = verdict_json(replace(MADE, map=shown(LEAK, rivals=rivals, shares=(0.4,))))
    (leak,) = content["map"]
    phase = leak.pop("phase")
    assert phase["name"] == "diastole" and 0.25 < phase["part"] < 1.0
    assert leak.pop("rms") == pytest.approx(math.sqrt(2.0) * ML)
    assert leak == {
        "kind": "outflow", "where": "B", "x": None, "label": "a loss of flow along B", "unit": "m^3/s",
        "share": 0.4, "rivals": [{"labels": ["the outlet of B"], "above": 3.0}],
    }  # fmt: skip
    assert content["map_leaves"] == {"chi2_per_datum": 1.0, "explains": True}
    (number,) = verdict_json(replace(MADE, map=shown(signal(place("number", "B.E")))))["map"]
    assert (number["rms"], number["file"], number["value"]) == (None, 9e5, pytest.approx(9e5))
    assert verdict_json(replace(MADE, map=shown()))["map"] == []
    assert (verdict_json(MADE)["map"], verdict_json(MADE)["map_leaves"]) == (None, None)


@pytest.mark.parametrize(
    ("spot", "kind", "where"),
    [
        (place("wall", "B"), "segment", "B"),
        (place("drop", "B", 0.3), "segment", "B"),
        (place("outlet", "B"), "outlet", "B"),
        (place("junction", "A"), "junction", "A"),
        (place("channel", "B.P"), "channel", "B"),
        (place("channel", "inlet.Q"), "channel", "inlet"),
        (place("number", "B.E"), "segment", "B"),
        (place("number", "B.outlet.R_t"), "outlet", "B"),
    ],
)
def test_places_are_marked_where_they_are(spot: Place, kind: str, where: str) -> None:
    found = mark(spot, True)
    assert (found.kind, found.place) == (kind, where)


def panels(acting: SourceMapShown) -> list[tuple[str, str]]:
    """Titles and units of the panels with the terms."""
    from discrepancy.report.figures import figure

    picture = figure(replace(MADE, map=acting), "terms")
    picture.canvas.draw()
    return [(axes.get_title(loc="left"), axes.get_ylabel()) for axes in picture.axes]


def test_the_figure_has_a_panel_for_each_signal() -> None:
    """In mmHg, mL/s and mm; none for a number."""
    lengthened = signal(place("channel", "C.R"), 1e-5)
    assert panels(shown(LEAK, SQUEEZED, lengthened)) == [
        ("A loss of flow along B", "g [mL/s]"),
        ("A pressure in the wall of C\nlinear along C", "g [mmHg]"),
        ("An additional signal of the sensor of C.R", "g [mm]"),
    ]
    number = replace(MADE, map=shown(signal(place("number", "B.E"))), **NO_OTHERS)
    assert "map" in figures(number) and "terms" not in figures(number)


def test_a_vessel_has_the_colour_of_what_acts_all_along_it() -> None:
    """Not that of what acts at one point of it, which has a diamond, whichever comes first."""
    from discrepancy.report.figures import figure

    picture = figure(replace(MADE, map=shown(signal(place("drop", "C", 0.9)), SQUEEZED)), "map")
    drop, wall = (line.get_color() for line in picture.legends[0].get_lines())
    lines = picture.axes[0].lines
    assert wall in [line.get_color() for line in lines]
    assert drop not in [line.get_color() for line in lines if line.get_marker() != "D"]
    assert [line.get_markerfacecolor() for line in lines if line.get_marker() == "D"] == [drop]


def test_the_page_begins_with_the_map() -> None:
    """Before the table of what disagrees; without places no figure, without a map nothing."""
    outcome = replace(MADE, map=shown(LEAK, SQUEEZED, rivals=[Rival((place("outlet", "B"), SQUEEZED.place), 3.0)]))
    drawings = figures(replace(outcome, **NO_OTHERS))
    assert {"map", "terms"} <= set(drawings)
    html = page(outcome, drawings)
    assert (
        html.index("<h2>What this means")
        < html.index("<h2>Where the missing physics acts")
        < html.index("<h2>Where model")
    )
    assert "The missing physics acts as:</p>" in html and "<li>a loss of flow along B: " in html
    assert html.index(drawings["map"].source) < html.index(drawings["terms"].source)
    nothing = replace(MADE, map=shown())
    assert "map" not in figures(replace(nothing, **NO_OTHERS)) and "No place shows a residual beyond noise" in page(
        nothing, {}
    )
    assert "Where the missing physics acts" not in page(MADE, {})
    assert "map" not in figures(replace(MADE, **NO_OTHERS))


# --- the journal --------------------------------------------------------------------------------------------------


def test_a_map_survives_a_journal_bit_by_bit(tmp_path: Path) -> None:
    """With sources of every kind, a number that stands out, and rivals."""
    number = place("number", "B.E")
    every = tuple({type(source): p for p in PLACES for source in p.sources}.values())
    signals = [replace(signal(p), g=np.full((K + 1, p.columns), 0.1 + 0.2j)) for p in (*every, number)]
    made = found(*signals, rivals=[Rival(PLACES[:3], 2.5)], x={"B.E": 0.3})
    naming = Naming("unknown", PROBLEM, nothing(), (), (), {}, (), 0.5, map=made)
    Journal(tmp_path, []).stage("naming", lambda: naming)
    again = Journal(tmp_path, []).stage("naming", pytest.fail).map
    assert again is not None
    assert (again.places, again.unknowns, again.rivals) == (made.places, made.unknowns, made.rivals)
    assert (again.score, again.chi2, again.n) == (made.score, made.chi2, made.n)
    assert np.array_equal(again.x, made.x) and np.array_equal(again.J, made.J)
    for a, b in zip(again.signals, made.signals, strict=True):
        assert np.array_equal(a.g, b.g) and np.array_equal(a.sd, b.sd)
    assert any(isinstance(s.place.unknown, Unknown) for s in again.signals)
    assert isinstance(shown_map(again, NETWORK, record(clean())).acting[0], Acting)
