"""What a notebook shows of results: HTML that is well formed and escaped, data frames in SI, figures with units."""

from __future__ import annotations

import builtins
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from drawn import TUBE
from recorded_walls import recording

from arterial_fmu.notebook.tables import table
from discrepancy.findings.outcome import Candidate, ChannelBeats, NamedEffect, Outcome
from fitting.records.virtual import table_wall
from fitting.results.estimate import Estimate
from fitting.wall.site_fit import fit
from fitting.wall.wall_fit import WallFit
from solver import Network, Waveforms, load

WALL = table_wall("AA")
TIME = np.linspace(0.0, 0.5, 6)
BEAT = Waveforms(
    TIME,
    {"inlet.Q": 1e-6 * TIME, "CA.P": 1e3 * TIME, "CA.R": 4e-3 + 0.0 * TIME, "CA.outlet.P": 9e2 * TIME},
    {"inlet.Q": "m^3/s", "CA.P": "Pa", "CA.R": "m", "CA.outlet.P": "Pa"},
    beats=3,
    change=2e-6,
    halved=2,
)
BATCH = replace(BEAT, columns={**BEAT.columns, "CA.P": np.stack([BEAT["CA.P"], 2.0 * BEAT["CA.P"]])})


class Cells(HTMLParser):
    """The texts of all cells; every tag must be closed in its order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.text = ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data
        if self.open[-1] in ("td", "th"):
            self.rows[-1].append(data)


@pytest.fixture(scope="module")
def fitted() -> WallFit:
    return fit(recording(WALL, 40.0), "S", WALL.h, "monotone")


@pytest.fixture(scope="module")
def outcome(sheep: Network) -> Outcome:
    """An outcome made by hand: one effect, one channel."""
    found = {"CA.phi0": Estimate(80e3, "Pa.s", (70e3, 90e3))}
    wave = np.sin(2.0 * np.pi * np.arange(50) / 50)
    return Outcome(
        verdict="effect",
        sentence="The model lacks wall viscosity at CA & <nothing else>.",
        record="r.csv",
        model="m.toml",
        kind="network",
        effects=(NamedEffect("wall_viscosity", ("CA",), found, 0.9),),
        candidates=(Candidate("wall_viscosity", ("CA",), found, 0.0, 1.1, 1.2, 0.0, True),),
        channels=(ChannelBeats("CA.P", wave, 0.1 + 0.0 * wave, 0.9 * wave, wave, (3.0, 3.1), (1.0, 1.1)),),
        time=0.01 * np.arange(50),
        gap_before=(3.0, 3.1),
        gap_after=(1.0, 1.1),
        network_before=sheep,
    )


# --- waveforms ----------------------------------------------------------------------------------------------------


def test_waveforms_in_html() -> None:
    """Least, mean and largest value in the unit that people read: 0 to 500 Pa are 0 to 3.7503 mmHg."""
    page = Cells(BEAT._repr_html_())
    assert page.rows[0] == ["variable", "unit", "least", "mean", "largest"]
    assert page.rows[2] == ["CA.P", "mmHg", "0", "1.8752", "3.7503"]
    assert "beat 3" in page.text and "were halved" in page.text


def test_frames_of_waveforms() -> None:
    """Headings and values are those of the CSV file; the members of a batch stand one below the other."""
    table = BEAT.to_polars()
    assert table.columns == ["time [s]", "inlet.Q [m^3/s]", "CA.P [Pa]", "CA.R [m]", "CA.outlet.P [Pa]"]
    assert np.array_equal(table["CA.P [Pa]"].to_numpy(), BEAT["CA.P"])
    batch = BATCH.to_polars()
    assert batch["member"].to_list() == [0] * 6 + [1] * 6
    assert np.array_equal(batch["CA.P [Pa]"].to_numpy(), BATCH["CA.P"].ravel())
    assert np.array_equal(batch["CA.R [m]"].to_numpy(), np.tile(BEAT["CA.R"], 2))


def test_pandas(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same frame from pandas; one sentence where it is not installed."""
    pandas = pytest.importorskip("pandas")
    frame = BEAT.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert {name: list(frame[name]) for name in frame} == BEAT.to_polars().to_dict(as_series=False)
    whole = builtins.__import__

    def without(name: str, *others: Any) -> Any:
        if name == "pandas":
            raise ImportError(name)
        return whole(name, *others)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match="^pandas is not installed: pip install pandas, or take to_polars"):
        BEAT.to_pandas()


def test_waveforms_drawn() -> None:
    """A panel for each variable with its unit; P and Q of inlets and sites, or what is named, by variable or place."""
    labels = {axes.get_title(loc="left"): axes.get_ylabel() for axes in BEAT.plot().axes}
    assert labels == {"inlet.Q": "mL/s", "CA.P": "mmHg"}
    assert [axes.get_title(loc="left") for axes in BEAT.plot("CA", "CA.outlet.P").axes] == [
        "CA.P",
        "CA.R",
        "CA.outlet.P",
    ]
    assert any(axes.get_xlabel() == "time [s]" for axes in BEAT.plot().axes)
    (panel,) = BATCH.plot("CA.P").axes
    assert [line.get_ydata()[-1] for line in panel.lines] == pytest.approx([3.750308, 7.500617], rel=1e-6)
    assert BEAT.plot("CA.P")._repr_png_().startswith(b"\x89PNG")
    with pytest.raises(
        ValueError, match=r"^CA.outlt.P: no variable or place of this result \(did you mean CA.outlet.P\?\); its iter"
    ):
        BEAT.plot("CA.outlt.P")


# --- networks -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["tube", "sheep", "circle_of_willis"])
def test_network_drawn(name: str) -> None:
    """Every segment by its name, every site as a circle; one arrow an inlet."""
    network = TUBE if name == "tube" else load(name)
    (axes,) = network.plot().axes
    texts = [text.get_text() for text in axes.texts]
    assert {segment.name for segment in network.segments} <= set(texts)
    assert texts.count("") == len(network.inlets)
    assert sum(line.get_marker() == "o" for line in axes.lines) == len(network.sites)


# --- fits and outcomes --------------------------------------------------------------------------------------------


def test_fit_shown(fitted: WallFit) -> None:
    """E, R0, φ0 and φ_NL with their intervals, h as given; the frame in SI; the figure with units."""
    rows = {row[0]: row[1:] for row in Cells(fitted._repr_html_()).rows}
    assert rows["h, mm"] == [f"{1e3 * WALL.h:.4g}", "given"]
    assert {"E, MPa", "R0, mm", "φ0, kPa·s"} <= rows.keys()
    table = {row["parameter"]: row for row in fitted.to_polars().to_dicts()}
    assert table["E"]["value"] == fitted.values["E"] and table["E"]["unit"] == "Pa"
    assert (table["phi0"]["low"], table["phi0"]["high"]) == fitted.ci95("phi0")
    assert not table["h"]["free"] and table["h"]["low"] == fitted.h
    loop, spectrum = fitted.plot().axes
    assert (loop.get_xlabel(), loop.get_ylabel()) == ("radius R, mm", "pressure P, mmHg")
    assert spectrum.get_ylabel().endswith("mmHg")


def test_outcome_shown(outcome: Outcome) -> None:
    """The sentence, escaped; the effect with its parameter and interval; the hypotheses as a frame."""
    page = Cells(outcome._repr_html_())
    assert "CA & <nothing else>" in page.text and "<nothing" not in outcome._repr_html_()
    assert page.rows[1] == ["wall viscosity at CA", "CA.phi0", "80 kPa·s", "70 … 90", "90 %"]
    assert "3.00 -> 1.00 on the fitted beats, 3.10 -> 1.10 on the held-out beats" in page.text
    (row,) = outcome.to_polars().to_dicts()
    assert row["effect"] == "wall_viscosity" and row["parameters"] == "CA.phi0 = 80 (70 to 90) kPa·s"
    (panel,) = outcome.plot("waveforms").axes
    assert (panel.get_xlabel(), panel.get_ylabel()) == ("time [s]", "mmHg")
    assert {text.get_text() for text in outcome.plot().axes[0].texts} >= {"AA", "CA"}
    with pytest.raises(ValueError, match="^loops: no such figure of this study; it has network, waveforms.$"):
        outcome.plot("loops")


def test_a_sentence_of_several_lines_has_a_list() -> None:
    """As a verdict that names several places; only its first line is bold, and text stays text."""
    found = table(
        "unknown: It acts as:\n- a {drop}\n- a <loss>\nNo law explains it.", ("effect",), [], ["a gap\n  of beats"]
    )
    assert found == (
        "<div><p><b>unknown: It acts as:</b></p><ul><li>a {drop}</li><li>a &lt;loss&gt;</li></ul>"
        "<p>No law explains it.</p><p>a gap</p><p>of beats</p></div>"
    )
