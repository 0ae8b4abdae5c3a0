"""Network files: units, exact round trips, whole files only, and a clear sentence for every bad file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from network_text import FORK
from random_networks import networks
from refused import refused

from solver.laws.outlets import Pressure, Reflection, Resistance, Windkessel
from solver.network.description import Network, Site
from solver.network.files import (
    bundled,
    dumps,
    find_network,
    loads,
    parse_quantity,
    read_network,
    write_network,
    write_whole,
)

# an edit of FORK -> the words that the sentence must contain: section, key, value, expected unit or range, remedy
BAD_FILES = {
    "wrong dimension": ('L = "4 cm"', 'L = "4 kPa"', ["AA.L", '"4 kPa"', "expected m", "correct the unit or the key"]),
    "unknown unit": ('R0 = "8.8 mm"', 'R0 = "8.8 nm3"', ["PD.R0", '"8.8 nm3"', "unit nm3 is not known", "expected m"]),
    "unit of a pure number": ("R_t = 0.3", 'R_t = "0.3 m"', ["PD.outlet.R_t", '"0.3 m"', "number without unit"]),
    "out of range": ('L = "4 cm"', 'L = "4 km"', ["AA.L = 4000 m", "length L", "[0.0001, 10] m", "check the value"]),
    "negative": ('E = "683 kPa"', 'E = "-683 kPa"', ["BT.E = -683000 Pa", "[100, 1e+10] Pa"]),
    "NaN": ("L = 0.04", "L = nan", ["BT.L = NaN", "finite", "in m"]),
    "infinity": ("R0 = 9e-3", "R0 = inf", ["BT.R0 = Infinity", "finite", "in m"]),
    "text for a number": ("R_t = 0.3", 'R_t = "small"', ["PD.outlet.R_t", '"small"', "must be a number", "such as"]),
    "bool for a number": ("R_t = 0.3", "R_t = true", ["PD.outlet.R_t = true", "must be a number"]),
    "list for a number": ("L = 0.04", "L = [0.04]", ["BT.L = [0.04]", "must be a number in m"]),
    "date for a number": ("L = 0.04", "L = 2017-01-01", ["BT.L", "2017-01-01", "must be a number in m"]),
    "number for a text": ('name = "fork"', "name = 5", ["top level: name = 5", "must be text", "quotes"]),
    "number for a segment": ('segment = "AA"', "segment = 1", ["inlet: segment = 1", "must be text"]),
    "missing key": ('h = "1.06 mm"\n', "", ["BT", "key h", "wall thickness", "is missing", 'h = "1 mm"']),
    "missing name": ('name = "fork"', "", ["top level", "key name is missing", "add name"]),
    "missing inlet": ('[inlet]\nsegment = "AA"\nQ_max = "55 cm^3/s"', "", ["inlet", "key segment is missing"]),
    "missing Windkessel key": ('C = "0.1 mL/mmHg"\n', "", ["BT.outlet", "key C (compliance C) is missing", "mL/mmHg"]),
    "unknown key": ('phi0 = "25', 'phi_0 = "25', ["AA", "unknown key 'phi_0'", "use one of", "did you mean phi0?"]),
    "wrong case": ("R0 = 9e-3", "r0 = 9e-3", ["BT", "unknown key 'r0'", "did you mean R0?"]),
    "unknown outlet key": ("R_t = 0.3", "Rt = 0.3", ["PD.outlet", "unknown key 'Rt'", "did you mean R_t?"]),
    "unknown junction key": ('in = ["AA"]', 'in = ["AA"]\nK = 1', ["junction AA", "unknown key 'K'", "mean k?"]),
    "unknown section": ("[fluid]", "[fluids]", ["top level", "unknown key 'fluids'", "did you mean fluid?"]),
    "two conditions": (
        "R_t = 0.3",
        'R_t = 0.3\nR = "1 mmHg*s/mL"',
        ["PD.outlet", "an outlet with two conditions", "Reflection and Resistance: R_t, R", "keep one of"],
    ),
    "no condition": ("R_t = 0.3", "", ["PD.outlet", "no condition", "R_t or R1, C, R2 or R or P_venous alone"]),
    "no outlet": ("[outlets.PD]\nR_t = 0.3", "", ["segment PD", "neither junction nor outlet", "give one"]),
    "unknown segment": ('"BT", "PD"', '"BT", "PT"', ["junction AA", "no segment 'PT'", "did you mean"]),
    "unknown law": ('name = "fork"', 'name = "fork"\nelastic_law = "hooke"', ["elastic_law = 'hooke'", "one of beta"]),
    "junction in single brackets": ("[[junctions]]", "[junctions]", ["junctions", "[[junctions]]", "double brackets"]),
    "junction of numbers": ('in = ["AA"]', "in = [1]", ["junction", "key in", "segment names", 'in = ["AA"]']),
    "junction of text": ('out = ["BT", "PD"]', 'out = "BT"', ["junction", "key out", "must list segment names"]),
    "junction without out": ('out = ["BT", "PD"]', "", ["junction", "key out", "must list segment names"]),
    "junctions of numbers": ("[[junctions]]", "junctions_ = 1\n[[junctions]]", ["unknown key 'junctions_'"]),
    "section not a section": ('name = "fork"', 'name = "fork"\nfluid = 3', ["line 5", "Cannot overwrite", "correct"]),
    "network not a section": ('name = "fork"', 'name = "fork"\nnetwork = 3', ["network = 3", "write [network]"]),
    "site not a section": ('name = "fork"', 'name = "fork"\nsites = {a = 3}', ["sites.a = 3", "write [sites.a]"]),
    "key twice": (
        "L = 0.04",
        "L = 0.04\nL = 0.05",
        ["not valid TOML", "line 20", "Cannot overwrite", "correct that line"],
    ),
    "section twice": ("[outlets.PD]", "[outlets.BT]", ["not valid TOML", "line 39", "twice", "correct that line"]),
    "unit without quotes": ('L = "4 cm"', "L = 4 cm", ["not valid TOML", "line 12", "stands in quotes"]),
    "open at the end": ("R_t = 0.3\n", "R_t = ", ["not valid TOML", "line 40", "the end of the file", "correct"]),
    "endless integer": ("R_t = 0.3", "R_t = 1" + "0" * 5000, ["not valid TOML", "integer of thousands of digits"]),
    "mu without density": (
        'rho = "1.06 g/cm^3"',
        'rho = 0\nmu = "4 mPa*s"',
        ["fluid.rho = 0 kg/m^3 is not allowed", "[1, 100000] kg/m^3"],
    ),
    "bad segment name": (
        "[segments.AA]",
        '[segments."A A"]',
        ["segment name 'A A'", "letters, digits and _", "rename"],
    ),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_error_says_file_place_value_and_remedy(case: str, tmp_path: Path) -> None:
    """A bad file raises ValueError: one sentence that starts with the file and names section, key, value, remedy."""
    old, new, words = BAD_FILES[case]
    assert FORK.count(old) == 1
    path = tmp_path / "fork.toml"
    path.write_text(FORK.replace(old, new), encoding="utf-8")
    refused(lambda: read_network(path), f"{path}: ", words)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ["cannot be read", "No such file", "check the path"]),
        (b"name = '\xff'", ["not UTF-8", "save it as UTF-8"]),
    ],
)
def test_unreadable_file(content: bytes | None, words: list[str], tmp_path: Path) -> None:
    """A file that is absent or not text raises a sentence with its name."""
    path = tmp_path / "fork.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError) as error:
        read_network(path)
    assert [word for word in (str(path), *words) if word not in str(error.value)] == []


def test_four_outlet_conditions() -> None:
    """The keys decide the condition; P_venous alone is a prescribed pressure and goes along with the others."""

    def outlet(keys: str) -> object:
        return loads(FORK.replace("R_t = 0.3", keys), "fork").outlets[1]

    assert outlet('R_t = 0.3\nP_venous = "1 kPa"') == Reflection("PD", P_venous=1000.0, R_t=0.3)
    assert outlet("R1 = 1e8\nC = 1e-9\nR2 = 1e9") == Windkessel("PD", R1=1e8, C=1e-9, R2=1e9)
    assert outlet('R = "1 MPa*s/m^3"') == Resistance("PD", R=1e6)
    assert outlet("P_venous = 100") == Pressure("PD", P_venous=100.0)


def test_sites() -> None:
    """No section: mid-vessel of each segment. An empty section: none. Keys: segment (default: the name), position."""
    assert loads(FORK, "fork").sites == (Site("AA", "AA", 0.5), Site("BT", "BT", 0.5), Site("PD", "PD", 0.5))
    assert loads(FORK + "[sites]", "fork").sites == ()
    some = loads(FORK + '[sites.BT]\n[sites.far]\nsegment = "PD"\nposition = 1', "fork").sites
    assert some == (Site("BT", "BT", 0.5), Site("far", "PD", 1.0))


@given(networks())
def test_text_round_trip_is_exact(network: Network) -> None:
    """loads(dumps(n)) is n bit for bit (repr tells -0.0 from 0.0)."""
    again = loads(dumps(network), "random")
    assert again == network and repr(again) == repr(network)


@given(st.floats(allow_nan=False, allow_infinity=False))
@example(5e-324)
@example(-0.0)
def test_every_double_survives_its_text(value: float) -> None:
    """repr(x) with any SI unit is read back as x, subnormals and the sign of zero included."""
    for unit in ("m", "Pa.s^2", "m^3/Pa", "kg/m^3"):
        assert repr(parse_quantity(f"{value!r} {unit}", unit, "x")) == repr(value)


def test_file_round_trip(tmp_path: Path) -> None:
    """A written network reads back equal, over an older file too, with nothing left beside it."""
    path = tmp_path / "fork.toml"
    path.write_text("old")
    network = loads(FORK, "fork")
    write_network(network, path)
    assert read_network(path) == network
    assert os.listdir(tmp_path) == ["fork.toml"]


def test_byte_order_mark_is_read_over(tmp_path: Path) -> None:
    """Editors on Windows may put U+FEFF at the start of the file."""
    (tmp_path / "fork.toml").write_bytes(b"\xef\xbb\xbf" + FORK.encode())
    assert read_network(tmp_path / "fork.toml") == loads(FORK, "fork")


@pytest.mark.parametrize("failing", ["write_bytes", "replace"])
def test_no_partial_file_on_failure(failing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """When the disk is full while writing or moving, the old file stays whole and nothing is left beside it."""
    path = tmp_path / "fork.toml"
    path.write_text("old")

    def write_half(self: Path, content: bytes) -> None:
        self.open("wb").close()
        raise OSError(28, "No space left on device")

    def no_move(*_: object) -> None:
        raise OSError(28, "No space left on device")

    if failing == "write_bytes":
        monkeypatch.setattr(Path, "write_bytes", write_half)
    else:
        monkeypatch.setattr(os, "replace", no_move)
    with pytest.raises(ValueError, match=r"fork\.toml: cannot be written \(No space left on device\)"):
        write_network(loads(FORK, "fork"), path)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["fork.toml"]


def test_write_into_no_directory(tmp_path: Path) -> None:
    """A path in a directory that does not exist, or below a file, raises a sentence with the path."""
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "none" / "fork.toml", tmp_path / "file" / "fork.toml"):
        with pytest.raises(ValueError, match=r"fork\.toml: cannot be written .* check the path and its directory\."):
            write_network(loads(FORK, "fork"), path)


def test_find_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A path that exists, or else a bundled name, or else a sentence that lists the bundled names."""
    monkeypatch.chdir(tmp_path)
    assert find_network("sheep") == bundled("sheep")
    (tmp_path / "mine.toml").write_text(FORK)
    assert find_network("mine.toml") == Path("mine.toml")
    with pytest.raises(
        ValueError, match="shep: neither a file nor .* one of adan56, .*sheep, sheep_nonlinear, .* .did you mean sheep"
    ):
        find_network("shep")
    with pytest.raises(
        ValueError, match=r"none/mine\.toml: neither a file nor a bundled network; give a path or one of"
    ):
        find_network(tmp_path / "none" / "mine.toml")
    with pytest.raises(ValueError, match=r"is a folder, not a network; give a network file or an FMU\."):
        find_network(tmp_path)


# Table 1 of the paper: L (cm), R0 (cm), h (mm), E (MPa), phi0 (kPa·s)
TABLE_1 = {
    "AA": (4, 0.948, 0.38, 1.539, 25.451),
    "PD": (10, 0.880, 0.91, 0.842, 12.746),
    "MD": (10, 0.855, 1.26, 0.617, 11.651),
    "DD": (15, 0.828, 1.10, 1.427, 24.514),
    "BT": (4, 0.900, 1.06, 0.683, 12.048),
    "CA": (15, 0.406, 0.78, 4.142, 77.082),
    "FA": (10, 0.282, 0.31, 2.260, 43.426),
    "VA1": (20, 0.384, 0.50, 4.121, 10.000),
    "VA2": (20, 0.387, 0.50, 0.237, 10.000),
    "VA3": (20, 0.817, 0.50, 3.636, 10.000),
}
RATIOS = {"AA": -0.915, "PD": -0.999, "MD": -0.888, "DD": -0.975, "BT": -1.380, "CA": 0.524, "FA": -0.395}


def test_sheep_is_table_1() -> None:
    """The bundled sheep network has the numbers of Table 1 (to 2e-16 by the conversion here), phiNL = 0, R_t = 0.3."""
    sheep = read_network(bundled("sheep"))
    assert [s.name for s in sheep.segments] == list(TABLE_1)
    for s in sheep.segments:
        L, R0, h, E, phi0 = TABLE_1[s.name]
        expected = [L * 1e-2, R0 * 1e-2, h * 1e-3, E * 1e6, phi0 * 1e3]
        assert [s.L, s.R0, s.h, s.E, s.phi0] == pytest.approx(expected, rel=3e-16)
        assert s.phiNL == s.ENL == 0.0
    assert sheep.outlets == tuple(Reflection(s, R_t=0.3) for s in ("CA", "VA1", "VA2", "VA3", "FA"))
    assert sheep.sites == tuple(Site(s, s, 0.5) for s in TABLE_1)
    assert (sheep.elastic_law, sheep.viscous_law, sheep.eta) == ("beta", "quadratic", 0.5)
    assert (sheep.inlet.segment, sheep.inlet.Q_max, sheep.inlet.T) == ("AA", 55e-6, 0.5)
    assert "10.1115/1.4034832" in sheep.reference


def test_sheep_nonlinear_differs_only_in_the_viscosity() -> None:
    """phiNL/phi0 are the paper's ratios [s] to round-off, 0 in the virtual branches; all else is the sheep network."""
    sheep, nonlinear = read_network(bundled("sheep")), read_network(bundled("sheep_nonlinear"))
    for s in nonlinear.segments:
        assert s.phiNL / s.phi0 == pytest.approx(RATIOS.get(s.name, 0.0), rel=3e-16)
    assert nonlinear.viscous_law == "monotone"
    linear = {f"{s.name}.phiNL": 0.0 for s in nonlinear.segments}
    assert nonlinear.with_parameters(linear).parameters() == sheep.parameters()
    assert nonlinear.junctions == sheep.junctions


def test_writing_follows_links_and_spares_what_is_no_file(tmp_path: Path) -> None:
    """A link stays a link and its target gets the content; a directory, like a device, is refused."""
    (tmp_path / "target.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "target.txt")
    write_whole(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink()
    assert (tmp_path / "target.txt").read_text() == "new"
    with pytest.raises(ValueError, match=r"cannot be written \(not a regular file\)"):
        write_whole(tmp_path, "new")
    with pytest.raises(ValueError, match=r"/dev/null: cannot be written \(not a regular file\)"):
        write_whole("/dev/null", "new")


def test_deeply_nested_text() -> None:
    """Two thousand brackets end in a sentence."""
    with pytest.raises(ValueError, match="deep.toml: .*nested too deeply"):
        loads("a = " + "[" * 2000 + "]" * 2000, "deep.toml")
