"""The bank of hidden effects: a fast part of it judged, its files resumed, its report on lines counted by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import beta, binomtest

from benchmarks.hidden import animals, bank
from benchmarks.hidden import report as page
from benchmarks.hidden import words as w
from benchmarks.hidden.calibration import brier, calibration_error, diagram, error_bounds, error_by_chance, named
from benchmarks.hidden.counts import Share
from benchmarks.hidden.row import row
from benchmarks.hidden.targets import Targets, median_bounds
from solver import Network, load
from solver.laws.outlets import Reflection
from solver.network.description import Segment
from solver.quantities.quantity import quantities
from tests.truth.animal import INDIVIDUAL
from tests.truth.hide import OUTSIDE, Effect
from tests.truth.plan import GROUPS, REPORTED, TUNING_SEED, plan
from tests.truth.records import Case

Line = dict[str, Any]


def whole(lines: Sequence[Line], network: Network) -> str:
    """Both pages of the bank."""
    return page.targets(lines, network) + page.behind(lines, network)


# --- records of the tuning plan, judged ------------------------------------------------------------------------------


# of the first records of the tuning plan: nulls of every base and noise, singles with d' ≥ 30 and separation ≥ 6, and
# singles that hardly show
NULLS, SEEN, FAINT = (6, 7, 26, 46, 58), (4, 17, 31, 53, 55), (5, 10, 29)


@cache
def bench_line(index: int) -> Line:
    """A bench record of the tuning plan, judged."""
    return row("bench", TUNING_SEED, index, plan("bench", REPORTED["bench"], TUNING_SEED)[index])


def one_and_more(indices: Sequence[int]) -> list[Any]:
    """The first; the second is slow, the others are further cases."""
    first, second, *others = indices
    further = (pytest.param(i, marks=pytest.mark.endurance) for i in others)
    return [first, pytest.param(second, marks=pytest.mark.deep), *further]


@pytest.mark.parametrize("index", one_and_more(NULLS))
def test_bench_nulls_raise_no_alarm(index: int) -> None:
    """Nothing hidden: verdict none."""
    line = bench_line(index)
    assert w.of([line], "null") and line["verdict"] == "none"


@pytest.mark.parametrize("index", one_and_more(SEEN))
def test_bench_names_what_is_visible_and_separable(index: int) -> None:
    """d' ≥ 30 and separation ≥ 6: one name, the true one, and parameters within 10 % of the effect."""
    (x,) = w.of([bench_line(index)], "single", 30.0)
    assert w.separation(x) >= 6.0
    assert w.single_right(x), (x["verdict"], w.truths(x), w.top(x))
    assert x["gap"]["fit"]["best"] < 1.4 < 2.0 < x["gap"]["held_out"]["given"]
    for name, size, error, _ in w.errors(x):
        assert abs(error) < 0.1 * abs(size), name


@pytest.mark.parametrize("index", one_and_more(FAINT))
def test_bench_gives_no_wrong_single_name(index: int) -> None:
    """However small, no effect of the catalogue is given another name."""
    (x,) = w.of([bench_line(index)], "single")
    assert not w.wrong(x)


@pytest.mark.parametrize(
    ("index", "hidden"),
    [
        pytest.param(11, (), marks=pytest.mark.deep),
        pytest.param(13, ("nonlinear_elasticity",), marks=pytest.mark.endurance),
    ],
)
def test_network(index: int, hidden: tuple[str, ...]) -> None:
    """Three pressures with nothing hidden, and P, Q, R at seven sites at 20 dB with a bent wall everywhere (d' 34)."""
    x = row("network", TUNING_SEED, index, plan("network", REPORTED["network"], TUNING_SEED)[index])
    assert w.truths(x) == hidden
    if not hidden:
        assert x["verdict"] == "none"
        return
    assert w.separation(x) > 6.0 and w.single_right(x) and w.right_place(x)


# --- files of lines --------------------------------------------------------------------------------------------------


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Records are not made but counted."""
    calls: list[int] = []

    def fake(kind: str, seed: int, index: int, case: Case, group: str, least: float) -> Line:
        calls.append(index)
        return {"kind": kind, "seed": seed, "index": index, "verdict": "none"}

    monkeypatch.setattr(bank, "row", fake)
    return calls


def test_what_is_hardly_visible_is_not_judged() -> None:
    """A sensor that is late by 0.1 µs: d' below 1 by truth and noise; no verdict, and none that is counted."""
    case = Case("bench", "CA", 40.0, (Effect("channel_lag", ("CA.R",), 1e-7),))
    x = row("bench", 11, 0, case, least=1.0)
    assert x["verdict"] == w.NOT_JUDGED and x["effects"][0]["d_prime"] < 1.0 and "seconds" not in x
    assert not w.judged([x]) and "1 with too small a d′" in page.origin([x | {"sources": "abc"}])


def test_a_killed_run_goes_on(tmp_path: Path, made: list[int]) -> None:
    """Whole lines are kept, a half-written one is made again, and the file is that of a run in one go."""
    path = tmp_path / "bench.jsonl"
    once = bank.Bank(tmp_path / "once.jsonl", "bench", 11, "abc")
    once.run(6, 1)
    killed = bank.Bank(path, "bench", 11, "abc")
    killed.run(4, 1)
    path.write_bytes(path.read_bytes()[:-10])
    made.clear()
    killed.run(6, 1)
    assert made == [3, 4, 5]
    assert path.read_bytes() == once.path.read_bytes()
    assert [x["index"] for x in bank.read(path)] == list(range(6))


def test_a_run_may_begin_later(tmp_path: Path, made: list[int]) -> None:
    """Records before ``first`` are left out, those up to ``limit`` judged."""
    bank.Bank(tmp_path / "bench.jsonl", "bench", 11, "abc").run(6, 1, first=4)
    assert made == [4, 5]


def test_foreign_lines_are_refused(tmp_path: Path, made: list[int]) -> None:
    """Another seed is another bank; other sources are, too."""
    path = tmp_path / "bench.jsonl"
    bank.Bank(path, "bench", 11, "abc").run(2, 1)
    with pytest.raises(bank.NotThisBank, match="holds bench records of seed 11"):
        bank.Bank(path, "bench", 12, "abc").run(4, 1)
    with pytest.raises(bank.NotThisBank, match="2 of 2 records were judged by other sources"):
        bank.Bank(path, "bench", 11, "def").run(4, 1)
    assert [x["sources"] for x in bank.read(path)] == ["abc", "abc"]


def test_sources_are_told_apart(tmp_path: Path) -> None:
    """The hash moves with a byte of what judges, and not with anything else."""
    for name in bank.JUDGED_BY:
        file = tmp_path / (name if name.endswith(".py") else f"{name}/module.py")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("x = 1\n")
    before = bank.sources_hash(tmp_path)
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("text")
    assert bank.sources_hash(tmp_path) == before
    (tmp_path / "discrepancy" / "module.py").write_text("x = 2\n")
    assert bank.sources_hash(tmp_path) != before


# --- counting --------------------------------------------------------------------------------------------------------


def _line(
    index: int,
    hidden: tuple[str, ...] = (),
    told: tuple[str, ...] = (),
    verdict: str = "effect",
    d_prime: float = 40.0,
    confidence: float = 0.9,
    where: str = "CA",
    told_where: str = "CA",
    **more: Any,
) -> Line:
    effects = [{"name": n, "where": [where], "size": 1.0, "d_prime": d_prime,
                "parameters": {f"{where}.size": 2.0}, "zeros": {f"{where}.size": 1.0}} for n in hidden]  # fmt: skip
    terms = [{"name": n, "where": [told_where]} for n in told]
    best = {"terms": terms, "score": 1.0, "cost": 1.0, "misfit": 0.0, "probability": confidence,
            "parameters": {f"{where}.size": {"value": 2.1, "ci95": [1.9, 2.3]}}}  # fmt: skip
    plain = {"index": index, "kind": "bench", "seed": 11, "sources": "abc", "channels": "CA", "dB": 40.0,
             "base": "sheep", "elastic_law": "beta", "viscous_law": "monotone", "separation": None, "rival": "",
             "place_separation": None, "confidence": confidence, "seconds": 0.5, "base_score": 0.0, "base_misfit": 0.0,
             "gap": {"fit": {}, "held_out": {"given": 9.0, "refitted": 5.0, "best": 1.0}}}  # fmt: skip
    said = {"verdict": verdict if told else "none", "top": [best] if told else [],
            "class": [terms] if verdict in ("effect", "several") and told else []}  # fmt: skip
    return plain | said | {"effects": effects} | more


LINES = [
    _line(0),
    _line(1),
    _line(2, (), ("channel_gain",), confidence=0.6),  # a false alarm
    _line(3, ("wall_viscosity",), ("wall_viscosity",)),
    _line(4, ("wall_viscosity",), ("wall_viscosity",)),
    _line(5, ("wall_viscosity",), ("channel_lag",)),  # wrong
    _line(6, ("stress_relaxation",), ("channel_lag",), "ambiguous", **{"class": [
        [{"name": "channel_lag", "where": ["CA.P"]}], [{"name": "stress_relaxation", "where": ["CA"]}]]}),
    _line(7, ("cubic_rate",), ("nonlinear_elasticity",), "unknown"),
    _line(8, ("cubic_rate",), ("nonlinear_elasticity",)),
    _line(9, ("wall_viscosity", "channel_gain"), ("channel_gain", "wall_viscosity"), "several"),
    _line(10, ("wall_viscosity", "channel_gain"), ("wall_viscosity",), "unknown"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("test", "expected"),
    [
        (w.detected, [2, 3, 4, 5, 6, 7, 8, 9, 10]),
        (w.named_right, [3, 4]),
        (w.wrong, [2, 5, 8]),
        (w.in_class, [3, 4, 6]),
        (w.both_named, [9]),
        (w.one_and_more, [9, 10]),
        (w.confident_right, [3, 4, 9, 10]),
    ],
)
def test_words(test: Callable[[Line], bool], expected: list[int]) -> None:
    """What each of eleven lines counts for, by hand."""
    assert [x["index"] for x in LINES if test(x)] == expected


def test_report_by_hand(tmp_path: Path) -> None:
    """Proportions of the eleven lines, and the page keeps what is around its marks."""
    text = whole(LINES, load("sheep"))
    for cells in (
        "false alarms on nulls, bench | ≤ 2 % | 33.3 % (1/3;",
        "bench, d′ ≥ 12, 40 dB: named right | ≥ 95 % | 50.0 % (2/4;",
        "bench, single wrong name, all sizes | ≤ 1 % | 25.0 % (1/4;",
        "bench, truth in the class, d′ ≥ 6 | ≥ 98 % | 75.0 % (3/4;",
        "bench, outside the catalogue: named without the note that more remains | ≤ 5 % | 50.0 % (1/2;",
        "bench, two effects, both d′ ≥ 30: both named | ≥ 80 % | 50.0 % (1/2;",
        "– one, and more remains | ≥ 95 % | 100.0 % (2/2;",
        "bench, parameter: median relative error | ≤ 10 % | +10.00 % (2) |",
        "bench, CPU time of find and name, one process | – | median 0.5, 95 % 0.5, largest 0.5 s; 11 |",
        "– at most 10 s | ≥ 95 % | 100.0 % (11/11; 71.5–100.0) | open |",
    ):
        assert cells in text, cells
    file = tmp_path / "page.md"
    file.write_text(f"before\n{page.BEGIN}what was there\n{page.END}\nafter\n", encoding="utf-8")
    page.write(text, file)
    page.write(text, file)
    written = file.read_text(encoding="utf-8")
    assert written.startswith("before\n") and written.endswith("after\n") and "what was there" not in written
    assert written.count("## Standard records\n") == 1


def test_confidence_by_hand() -> None:
    """Stated 0.6: 0 of 1 right; stated 0.9: lines 3, 4, 9 of 3, 4, 5, 6, 8, 9. (1·0.6 + 6·0.4)/7. Brier: of
    each line (stated - right)²."""
    stated = named(LINES)
    assert calibration_error(stated) == pytest.approx((0.6 + 6.0 * 0.4) / 7.0, abs=1e-12)
    assert brier(stated) == pytest.approx((0.36 + 3 * 0.01 + 3 * 0.81) / 7.0, abs=1e-12)
    assert diagram(LINES).startswith(b"\x89PNG")


def test_places() -> None:
    """AA meets BT at a junction, not CA; a channel is where its site is; "all" is next to nothing."""
    sheep = load("sheep")
    for told, right, near in (("CA", True, True), ("BT", False, True), ("CA.P", False, True), ("FA", False, False),
                              ("all", False, False)):  # fmt: skip
        x = _line(0, ("side_branch",), ("side_branch",), told_where=told, kind="network")
        assert (w.right_place(x), w.adjacent_place(x, sheep)) == (right, near), told


@pytest.mark.parametrize(("hits", "n"), [(0, 300), (3, 50), (50, 50)])
def test_bounds(hits: int, n: int) -> None:
    """Clopper and Pearson as SciPy has them."""
    exact = binomtest(hits, n).proportion_ci(0.95, "exact")
    assert Share(hits, n).bounds == pytest.approx((exact.low, exact.high), abs=1e-12)


@pytest.mark.parametrize("index", [NULLS[0], SEEN[0], FAINT[0]])
def test_lines_are_plain_json(index: int) -> None:
    """No infinities, no arrays; effects outside the catalogue are known to the judge alone."""
    line = bench_line(index)
    json.loads(json.dumps(line, allow_nan=False))
    assert not {t["name"] for h in line.get("top", ()) for t in h["terms"]} & set(OUTSIDE)


# --- partial answers, and the groups ---------------------------------------------------------------------------------


PARTIAL = [
    _line(20, ("stenosis",), ("stenosis",), "partial", **{"class": [[{"name": "stenosis", "where": ["CA"]}]]}),
    _line(21, ("stenosis",), ("side_branch",), "partial", **{"class": [[{"name": "side_branch", "where": ["CA"]}]]}),
    _line(22, ("coulomb",), ("wall_viscosity",), "partial", **{"class": [[]] * 2}),
    _line(23, ("stenosis", "taper"), ("stenosis",), "partial", **{"class": [[]]}),
]


@pytest.mark.parametrize(
    ("test", "expected"),
    [
        (w.detected, [20, 21, 22, 23]),
        (w.claims, [20, 21, 22, 23]),
        (w.single, [20, 21, 23]),
        (w.committed, []),
        (w.named_right, [20]),
        (w.single_right, [20]),
        (w.wrong, [21]),
        (w.in_class, [20]),
        (w.one_and_more, [20, 23]),
        (w.confident_right, [20, 23]),
    ],
)
def test_partial_names(test: Callable[[Line], bool], expected: list[int]) -> None:
    """It names, and never without saying that more remains; a single wrong name under it is a wrong one."""
    assert [x["index"] for x in PARTIAL if test(x)] == expected


def _spot(segment: str) -> dict[str, Any]:
    return {"kind": "wall", "name": segment, "at": None}


def test_places_that_cannot_be_told_apart() -> None:
    """A set of three places counts where one of them is right, each kind and segment once; one of four does not, nor
    one beside another place of the map, nor what is added to it."""
    wall, drop, near = _spot("CA"), _spot("CA") | {"kind": "drop", "at": 0.1}, _spot("CA") | {"kind": "drop", "at": 0.3}
    loss, end = _spot("CA") | {"kind": "outflow"}, _spot("CA") | {"kind": "outlet"}

    def right(places: list[dict[str, Any]], alike: list[list[dict[str, Any]]], most: int = 3) -> bool:
        line = _line(0, ("coulomb",), (), "unknown", kind="network") | {"map": {"places": places, "alike": alike}}
        return w.acts_right(line, most)

    assert right([wall], [], 1) and not right([drop], [])
    assert right([drop], [[near], [loss], [wall]]) and not right([drop], [[wall]], 1)
    assert not right([drop], [[end], [loss], [wall]])
    assert not right([drop], [[drop, wall]])
    assert right([drop, end], [[wall, end], [drop, loss], [drop, _spot("BT")]])  # in the stead of the drop
    assert not right([drop, end], [[drop, wall], [drop, loss], [drop, _spot("BT")]])  # of the outlet, with two more


def test_groups_have_their_tables() -> None:
    """Walls, sensors, beats, places and effects outside the catalogue, each counted by hand."""
    sheep = load("sheep")
    network = {"kind": "network", "channels": "all"}
    lines = [
        _line(0, **network, group="walls", walls=0.5),
        _line(1, (), ("taper",), **network, group="walls", walls=1.5),
        _line(2, ("stenosis",), ("stenosis",), **network, group="walls", walls=1.0),
        _line(3, **network, group="varying", verdict="none"),
        _line(4, **network, group="varying") | {"verdict": "unusable"},
        _line(5, ("coulomb",), ("taper",), **network, group="outside_walls"),
        _line(6, ("stenosis",), ("stenosis",), **network, group="offcentre", walls=0.0),
        _line(7, group="sensors", sensors="radius 2 µm"),
        _line(8, ("wall_stiffness",), ("wall_stiffness",), **network, group="own", walls=1.0),
        _line(9, ("wall_radius",), (), **network, group="own", walls=1.0, verdict="unknown")
        | {"map": {"places": [{"kind": "number", "name": "CA.R0", "at": None}]}},
        _line(10, ("stenosis",), ("stenosis",), **network, group="elastic", walls=1.0),
        _line(11, ("stenosis", "taper"), ("stenosis", "taper"), "several", **network, group="elastic", walls=1.0),
        _line(12, ("stenosis", "taper"), ("stenosis",), "partial", **network, group="pairs", walls=1.0),
        _line(13, ("stenosis",), ("taper",), "ambiguous", **network, group="three", walls=1.0)
        | {"class": [[{"name": "taper", "where": ["BT"]}], [{"name": "stenosis", "where": ["CA"]}]]},
        _line(14, ("stenosis",), ("taper",), "unknown", 20.0, **network, group="three", walls=1.0)
        | {"map": {"places": [_spot("BT")], "alike": [[_spot("MD")], [_spot("BT")]]}},
    ]
    text = whole(lines, sheep)
    for cells in (
        "nothing hidden: false alarms | ≤ 3 % | 50.0 % (1/2;",
        "– spread × 1.5 | – | 100.0 % (1/1;",
        "d′ ≥ 30: right name in the class | ≥ 90 % | 100.0 % (1/1; 2.5–100.0) | open |",
        "gap on held-out beats after/before, effects named right | ≤ 0.3 | median 0.11, 90 % 0.11; 1 | open |",
        "network, nothing hidden: false alarms | ≤ 5 % | 0.0 % (0/2;",
        "network, nothing hidden: unusable | ≤ 25 % | 50.0 % (1/2; 1.3–98.7) | **no** |",
        "network, outside the catalogue: named without the note that more remains | ≤ 5 % | 100.0 % (1/1;",
        "– at most 60 s | ≥ 95 % | 100.0 % (3/3; 29.2–100.0) | open |",
        "– more than 300 s | none | 0.0 % (0/3; 0.0–70.8) | open |",
        "walls alike, d′ ≥ 30: named right | – | 100.0 % (1/1;",
        "| effect | 2 | 50.0 % (1/2; 1.3–98.7) | 9.00 | 1.00 | 0.11 |",
        "bench, nothing hidden: false alarms | ≤ 2 % | 0.0 % (0/1; 0.0–97.5) | open |",
        "outlier of E or R_t, d′ ≥ 12: named at its place | ≥ 95 % | 100.0 % (1/1;",
        "outlier of R0, d′ ≥ 12: on the map at its place | ≥ 95 % | 100.0 % (1/1;",
        "two effects, both d′ ≥ 30: both named | ≥ 85 % | 100.0 % (1/1;",
        "two effects, both d′ ≥ 30: both named | ≥ 85 % | 0.0 % (0/1;",
        "– or one of them, with the note that more remains | all | 100.0 % (1/1;",
        "d′ ≥ 12: the reported places include the true one | ≥ 95 % | 50.0 % (1/2;",
        "– number of reported places, if any | ≤ 3 | median 2.00, 90 % 2.00; 2 | open |",
        "d′ ≥ 30: the reported places include the true one | ≥ 95 % | 100.0 % (1/1;",
    ):
        assert cells in text, cells
    for title in page.TITLES.values():
        assert (f"## {title}\n" in text) == (f"## {title}: verdicts\n" in text) == (title != "Standard records")


def test_bounds_of_a_median() -> None:
    """Of 1 … 100 the 40th and 61st, the usual table's; of five numbers there is none."""
    assert median_bounds(range(1, 101)) == (40, 61)
    assert median_bounds([1.0] * 5) == (-np.inf, np.inf)


# --- what a few records cannot show ----------------------------------------------------------------------------------


def _met(t: Targets) -> list[str]:
    """The last column of a table of targets."""
    return [line.split(" | ")[-1].rstrip(" |") for line in str(t).splitlines()[2:]]


def _right(n: int, confidence: float = 0.989) -> list[Line]:
    return [_line(i, ("stenosis",), ("stenosis",), confidence=confidence) for i in range(n)]


@pytest.mark.parametrize("n", [4, 150])
def test_bounds_of_a_calibration_error(n: int) -> None:
    """n of n right, stated 0.989: |0.989 - p| with p from Beta(n + 1/2, 1/2) is in the interval in 95 % of cases, 2.5 %
    at either end; to draw the records again would give no width."""
    p = beta(n + 0.5, 0.5)
    for bound, below in zip(error_bounds(_right(n)), (0.025, 0.975), strict=True):
        assert p.cdf(0.989 + bound) - p.cdf(0.989 - bound) == pytest.approx(below, abs=0.005)
    assert error_bounds(_right(n)) == error_bounds(_right(n))


def test_the_error_of_exact_confidences() -> None:
    """One bin of n records at p: mean |share - p| is sqrt(2 p (1 - p)/(π n)), by the normal limit of a binomial."""
    mean, most = error_by_chance(_right(400))
    p = _right(400)[0]["confidence"]
    assert mean == pytest.approx(np.sqrt(2.0 * p * (1.0 - p) / (np.pi * 400)), rel=0.05)
    assert most > mean


@pytest.mark.parametrize(("lines", "met"), [(_right(4), "open"), (_right(150), "yes"), (_right(150, 0.9), "**no**")])
def test_calibration_is_met_by_its_bound(lines: list[Line], met: str) -> None:
    """Four records without a miss do not show 0.05; 150 do; 0.1 too little is a miss."""
    t = Targets()
    t.confidence("network", lines)
    assert _met(t) == [met]


@pytest.mark.parametrize(
    ("errors", "met"),
    [
        ([0.01] * 5, "open"),
        ([0.01] * 6, "yes"),
        ([-0.2] * 3 + [0.0] * 10 + [0.2] * 3, "yes"),
        ([-0.2] * 4 + [0.0] * 6, "open"),
        ([0.0] * 6 + [0.2] * 4, "open"),
        ([-0.2] * 10, "**no**"),
    ],
)
def test_bias_is_met_by_its_bounds(errors: list[float], met: str) -> None:
    """The order statistics of the median, both of them, are to be within 10 %: of ten numbers the second and ninth."""
    lines = _right(len(errors))
    for x, error in zip(lines, errors, strict=True):
        x["top"][0]["parameters"]["CA.size"] = {"value": 2.0 + error, "ci95": [1.9, 2.3]}
    t = Targets()
    t.parameters("network", lines)
    assert _met(t)[0] == met


@pytest.mark.parametrize(
    ("seconds", "met"),
    [
        ([1.0] * 4, ["–", "open", "open"]),
        ([1.0] * 72, ["–", "yes", "open"]),
        ([1.0] * 200 + [200.0], ["–", "yes", "open"]),
        ([1.0] * 200 + [300.5], ["–", "yes", "**no**"]),
        ([1.0] * 9 + [61.0], ["–", "**no**", "open"]),
    ],
)
def test_times_are_met_by_their_shares(seconds: list[float], met: list[str]) -> None:
    """95 % within 60 s takes 72 records without a slow one; that none is above 300 s is open at best."""
    t = Targets()
    t.seconds("network", 60.0, 300.0, [{"seconds": s} for s in seconds])
    assert _met(t) == met


@pytest.mark.parametrize(("hits", "n", "met"), [(72, 72, ["open"]), (71, 72, ["**no**"]), (0, 0, [])])
def test_all_is_open_at_best(hits: int, n: int, met: list[str]) -> None:
    """A single exception misses it, no number of records shows it; without records there is no row."""
    t = Targets()
    t.every("named", Share(hits, n))
    assert _met(t) == met


@pytest.mark.parametrize("group", ["standard", "outside_walls"])
@pytest.mark.parametrize("kind", ["bench", "network"])
def test_outside_the_catalogue_of_all_sizes(group: str, kind: str) -> None:
    """One of two is named, the one of d' 10: 1/2 of all sizes, and 0/1 of d' ≥ 30."""
    far = {"kind": kind, "group": group, "walls": 1.0}
    lines = [
        _line(0, ("coulomb",), ("taper",), d_prime=10.0, **far),
        _line(1, ("coulomb",), ("taper",), "unknown", **far),
    ]
    text = whole(lines, load("sheep"))
    assert (
        f"{kind}, outside the catalogue: named without the note that more remains | ≤ 5 % | 50.0 % (1/2; 1.3–98.7) | "
        "**no** |\n| – of these with d′ ≥ 30 | ≤ 5 % | 0.0 % (0/1; 0.0–97.5) | open |"
    ) in text


def test_every_group_has_targets() -> None:
    """The groups of the plan other than the standard one."""
    assert {"standard", *animals.GROUPS} == set(GROUPS)


def test_walls_are_drawn_from_what_is_assumed() -> None:
    """What the page says of the group: the workflow's spreads between arteries, but for R_t, 0.02 against 0.03."""
    known = quantities(Segment) | quantities(Reflection)
    assumed = {key: known[key].individual for key in INDIVIDUAL}
    assert assumed == INDIVIDUAL | {"R_t": 0.03}
    assert GROUPS["walls"].walls == (0.5, 1.0, 1.5)
    said = "E 8 %, φ0 20 %, R0 2 %, R_t 0.02 (the workflow assumes 0.03)"
    assert said in (bank.ROOT / "docs" / "hidden-effects.md").read_text(encoding="utf-8")
