"""The page and the drawing in an FMU, for networks of every shape."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np
import pytest
from drawn import TUBE, segment

from fmu_src.contents.models import body_model, heart_model
from fmu_src.documents import drawing
from fmu_src.documents.document import documents, index_html
from fmu_src.variables.arteries_variables import variable_table
from solver import Inlet, Network, Pressure, Reflection, Resistance, Settings, Site, Windkessel, load
from solver.network.description import Junction

# beside one tube: three kinds of outlets at one junction; a loop; a circle of flow
FORK = Network(
    "fork",
    (segment("aorta", 0.01), segment("left_carotid", 0.004), segment("vertebral", 0.002), segment("descending", 0.009)),
    Inlet("aorta"),
    (Junction(("aorta",), ("left_carotid", "vertebral", "descending")),),
    (Windkessel("left_carotid", 1e8, 1e-9, 1e9), Resistance("vertebral", 1e9), Pressure("descending")),
    (Site("root", "aorta", 0.0), Site("end", "vertebral", 1.0)),
)
LOOP = Network(
    "loop",
    (segment("A", 0.01), segment("B", 0.008), segment("C", 0.005), segment("D", 0.004), segment("E", 0.009)),
    Inlet("A"),
    (Junction(("A",), ("B", "C")), Junction(("B",), ("D",)), Junction(("C", "D"), ("E",))),
    (Reflection("E", R_t=0.1),),
    (Site("middle", "C"),),
)
CIRCLE = Network(
    "circle",
    (segment("A", 0.01), segment("B", 0.008), segment("C", 0.005), segment("D", 0.004)),
    Inlet("A"),
    (Junction(("A", "C"), ("B",)), Junction(("B",), ("C", "D"))),
    (Reflection("D", R_t=0.1),),
)
DRAWN = [TUBE, FORK, LOOP, CIRCLE]


# --- documents ----------------------------------------------------------------------------------------------------


class Page(HTMLParser):
    """Checks that tags are closed in order, and collects the text and every address."""

    VOID = ("meta", "br", "circle", "path", "polyline")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[list[str]] = []
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for key, value in attributes if key in ("src", "href", "xlink:href")]
        if tag == "tr":
            self.cells.append([])
        if tag in ("td", "th"):
            self.cells[-1].append("")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag != "circle":
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and {"td", "th"} & set(self.open):
            self.cells[-1][-1] += data


@pytest.mark.parametrize("network", DRAWN, ids=lambda n: n.name)
def test_page(network: Network) -> None:
    """The page is well formed and self-contained, and lists every variable with unit, start and range."""
    table = variable_table(network, Settings())
    text = index_html(network, table, "1.2.3")
    page = Page(text)
    assert all(address.startswith("https://doi.org/") for address in page.addresses)
    assert not re.search(r"@import|url\(|<script", text)
    rows = {cells[0]: cells for cells in page.cells}
    for v in table:
        name, kind, unit, *start, allowed, meaning = rows[v.name]
        assert (name, kind, meaning) == (v.name, v.variability, v.description)
        if v.quantity is None:
            assert (start, allowed) == ([v.start], ", ".join(f"{i} {c}" for i, c in enumerate(v.choices, 1)))
        else:
            assert unit.startswith("–" if v.quantity.unit == "1" else v.quantity.unit)
            assert len(start) == (v.causality != "output")
            assert v.start is None or float(start[0].split()[0]) == pytest.approx(v.start, rel=1e-5)
    for word in ("hold", "linear", "smooth", "periodic", "venous.V", "logging", "numpy", "libpython", "network.toml"):
        assert word in text


def test_page_of_either_inlet() -> None:
    """The port, the interpolation and the start are told for what drives the inlet, flow or pressure."""
    for causality, said, unsaid in (
        ("flow", ("P(t + h) = P_0 + Z_0 Q(t) + Z Q(t + h)", "it is Q(t)", "inlet.Q_mean"), ("inlet.Y", "inlet.P_mean")),
        ("pressure", ("Q(t + h) = Q_0 + Y_0 P(t) + Y P(t + h)", "it is P(t)", "inlet.P_mean"), ("inlet.Z", "Q_mean")),
    ):
        network = replace(TUBE, inlet=replace(TUBE.inlet, causality=causality))
        text = index_html(network, variable_table(network, Settings()), "1.2.3")
        assert all(words in text for words in said)
        assert not any(words in text for words in unsaid)


def test_the_picture_is_where_each_version_of_fmi_looks() -> None:
    """In the root for FMI 2.0; as the diagram among the documents for FMI 3.0, too."""
    network = load("sheep")
    table = variable_table(network, Settings())
    for fmi, further in ((0, set()), (2, set()), (3, {"documentation/diagram.png"})):
        found = documents(network, table, "1", fmi)
        pictures = {path for path in found if path.endswith(".png")}
        assert pictures == {"model.png"} | further and len({found[path] for path in pictures}) == 1


def test_pages_of_heart_and_body() -> None:
    """Well formed, with every variable and what the host needs; outputs have no column of start values."""
    for model in (heart_model("human"), body_model("sheep")):
        text = model.documents["documentation/index.html"].decode()
        rows = {cells[0]: cells for cells in Page(text).cells}
        assert all(len(rows[v.name]) == 6 - (v.causality == "output") for v in model.table)
        assert "What the host needs" in text


@pytest.mark.parametrize("network", DRAWN, ids=lambda n: n.name)
def test_drawing(network: Network) -> None:
    """One line per segment, from its start to its end, inside the picture; wider for wider arteries; marks beside."""
    lanes = drawing.lanes(network)
    nodes: dict[tuple[float, float], list[str]] = {}
    for lane in lanes:
        for at in (lane.path[0], lane.path[-1]):
            nodes.setdefault(tuple(np.round(at, 9).tolist()), []).append(lane.segment.name)
    # segments meet where their junction is, and nowhere else
    joined = sorted(sorted(names) for names in nodes.values() if len(names) > 1)
    assert joined == sorted(sorted((*j.inflow, *j.outflow)) for j in network.junctions)
    svg = drawing.network_svg(network)
    root = ElementTree.fromstring(svg)
    width, height = (float(root.attrib[key]) for key in ("width", "height"))
    lines = [node for node in root if node.tag.endswith("polyline")]
    widths = [float(node.attrib["stroke-width"]) for node in lines]
    by_radius = [w for _, w in sorted(zip((s.R0 for s in network.segments), widths, strict=True))]
    assert by_radius == sorted(widths)
    assert len(lines) == len(network.segments)
    for node in lines:
        points = np.array([[float(x) for x in point.split(",")] for point in node.attrib["points"].split()])
        assert (points > 0).all() and (points < [width, height]).all()
    texts = {node.text for node in root if node.tag.endswith("text")}
    assert {s.name for s in network.segments} <= texts
    assert sum(node.tag.endswith("circle") for node in root) == len(network.sites)


def test_long_chain_is_drawn() -> None:
    """1200 segments in a row: no depth of recursion is reached, and the lanes follow each other at one height."""
    names = [f"S{i}" for i in range(1200)]
    chain = Network(
        "chain",
        tuple(segment(name, 0.01) for name in names),
        Inlet("S0"),
        tuple(Junction((a,), (b,)) for a, b in pairwise(names)),
        (Reflection(names[-1], R_t=0.0),),
    )
    assert [(lane.x0, lane.x1, lane.y) for lane in drawing.lanes(chain)] == [(i, i + 1, 0.0) for i in range(1200)]
