"""The beat on the first page of the docs: its engine against the native FMU, in a runtime and in a browser."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import zlib
from collections.abc import Iterator, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any

import numpy as np
import pytest
from fmus import Instance
from native_fmus import needs_compiler

from build_fmu import build_native
from docs import live
from fmu_src import compiler
from solver import load

DOCS = Path(live.__file__).parent
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
EQUAL = 1e-13  # of the pulse; here the same bits, other machines may round otherwise
BEATS = 2  # of each setting, one after the other
# heart rate [1/min], then what the sliders are at
SETTINGS = {
    "sheep": ((150.0, 1.6, 0.5, 0.2), (80.0, 0.7, 2.0, -0.1)),
    "human": ((90.0, 1.6, 0.5, 1.3), (55.0, 0.7, 2.0, 0.8)),
}
pytestmark = [
    needs_compiler,
    pytest.mark.skipif(compiler.ziglang() is None, reason="ziglang is not installed"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def script() -> str:
    return live.script()


@pytest.fixture(scope="module")
def data(script: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(script[script.index("{") :].rstrip(";\n"))
    return found


@pytest.fixture(scope="module")
def expected(data: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """What the page shows of each network, from the native FMU through FMPy : (steps, 4)."""
    found = {}
    for name, network in zip(live.SHOWN, data["networks"], strict=True):
        folder = tmp_path_factory.mktemp(name)
        one = Instance(build_native(load(name), folder, live.SHOWN[name].settings), folder / "unpacked")
        one.initialize({"inlet.interpolation": "linear", "network.start": "periodic"})
        t, rows = 0.0, []
        for T, values in settings(name, network):
            for vr, value in values.items():
                one.slave.setReal([vr], [value])
            for Q in BEATS * network["inflow"]:
                one.slave.setReal([network["inlet"]], [Q])
                one.slave.doStep(t, T / len(network["inflow"]))
                t += T / len(network["inflow"])
                rows.append(one.slave.getReal(channels(network)))
        assert one.messages == []
        one.slave.freeInstance()
        found[name] = np.array(rows)
    return found


def settings(name: str, network: Mapping[str, Any]) -> Iterator[tuple[float, dict[int, float]]]:
    """The period [s], and the parameters by value reference, of each setting."""
    for rate, *moved in SETTINGS[name]:
        values = {}
        for slider, by in zip(network["sliders"], moved, strict=True):
            starts = zip(slider["vr"], slider["start"], strict=True)
            values |= {vr: x * by if slider["kind"] == "factor" else x + by for vr, x in starts}
        yield 60.0 / rate, values


def channels(network: Mapping[str, Any]) -> list[int]:
    return [site[key] for key in "PQ" for site in network["sites"]]


def off(found: np.ndarray, wanted: np.ndarray) -> float:
    """The largest difference, in parts of the pulse of each channel."""
    return float((np.abs(found - wanted).max(axis=0) / np.ptp(wanted, axis=0)).max())


# --- in a runtime -----------------------------------------------------------------------------------------------------


def unpacked(text: str) -> bytes:
    return zlib.decompress(base64.b64decode(text))


class Arteries:
    """docs/live-arteries.js in wasmtime."""

    def __init__(self, engine: bytes, network: Mapping[str, Any]) -> None:
        wasmtime = pytest.importorskip("wasmtime", reason="wasmtime is not installed")
        resource, i32 = unpacked(network["resource"]), wasmtime.ValType.i32()
        self.store = wasmtime.Store()
        module = wasmtime.Module(self.store.engine, engine)
        page = {
            "size": wasmtime.Func(self.store, wasmtime.FuncType([], [i32]), lambda: len(resource)),
            "read": wasmtime.Func(self.store, wasmtime.FuncType([i32], []), lambda at: self.put(at, resource)),
        }
        made = wasmtime.Instance(self.store, module, [page[each.name] for each in module.imports])
        self.exports = made.exports(self.store)
        self.call("_initialize")
        self.room = self.call("malloc", 1 << 16)
        self.values = self.room + (1 << 15)
        self.put(self.room, b"\0")
        self.component = self.call("component_new", self.room, self.room, self.values, 1024)
        for vr, value in network["first"]:
            self.write([vr], [value], kind=1)
        assert self.call("component_enter", self.component) == self.call("component_leave", self.component) == 1

    def call(self, name: str, *arguments: float) -> Any:
        return self.exports[name](self.store, *arguments)

    def put(self, at: int, content: bytes) -> None:
        self.exports["memory"].write(self.store, content, at)

    def write(self, vr: Sequence[int], values: Sequence[float], kind: int = 0) -> None:
        self.put(self.room, np.array(vr, np.uint32).tobytes())
        self.put(self.values, np.array(values, float).tobytes())
        assert self.call("component_write", self.component, self.room, len(vr), kind, self.values) == 1

    def read(self, vr: Sequence[int]) -> np.ndarray:
        self.put(self.room, np.array(vr, np.uint32).tobytes())
        assert self.call("component_read", self.component, self.room, len(vr), 0, self.values) == 1
        return np.frombuffer(self.exports["memory"].read(self.store, self.values, self.values + 8 * len(vr)))


@pytest.mark.parametrize("name", live.SHOWN)
def test_equals_the_native_fmu(data: dict[str, Any], expected: dict[str, np.ndarray], name: str) -> None:
    """Two settings of all sliders, one after the other, from the periodic start (measured: the same bits)."""
    network = data["networks"][list(live.SHOWN).index(name)]
    one, t, rows = Arteries(unpacked(data["engine"]), network), 0.0, []
    for T, values in settings(name, network):
        one.write([*values], [*values.values()])
        for Q in BEATS * network["inflow"]:
            one.write([network["inlet"]], [Q])
            assert one.call("component_step", one.component, t, T / len(network["inflow"])) == 1
            t += T / len(network["inflow"])
            rows.append(one.read(channels(network)))
    assert off(np.array(rows), expected[name]) <= EQUAL


# --- in a browser -----------------------------------------------------------------------------------------------------

TELLER = """
const tell = (found) => fetch("ADDRESS", { method: "POST", mode: "no-cors", body: JSON.stringify(found) });
addEventListener("error", (event) => tell({ error: event.message }));
addEventListener("unhandledrejection", (event) => tell({ error: String(event.reason) }));
"""
DRIVER = """
addEventListener("load", async () => {
  const { live } = document.querySelector(".arterial-live"), found = { rows: [] };
  const settled = async () => {
    do await new Promise(requestAnimationFrame); while (!live.settled);
    return [...document.querySelectorAll(".arterial-live path.now")].map((path) => path.getAttribute("d"));
  };
  for (const [i, all] of SETTINGS.entries()) {
    const network = arterialLive.networks[i], rows = [];
    const one = await Arteries.open(await live.engine, network);
    for (const [T, values] of all) {
      for (const [vr, value] of values) one.write([vr], [value]);
      for (let k = 0; k < BEATS; k++) rows.push(...one.beat(T, CHANNELS[i]));
    }
    found.rows.push(rows);
  }
  found.first = await settled();
  const { input } = live.sliders[0];
  input.value = input.max;
  input.dispatchEvent(new Event("input"));
  found.moved = await settled();
  live.reset();
  found.reset = await settled();
  found.state = live.state.textContent;
  tell(found);
});
"""
# another network is asked for: while it loads, after that failed, after its first beat failed, when it is there
ASKING = """
addEventListener("load", async () => {
  const { live } = document.querySelector(".arterial-live"), found = {}, { open } = Arteries;
  const frames = async (n) => { for (let k = 0; k < n; k++) await new Promise(requestAnimationFrame); };
  const seen = () => {
    live.draw();
    const pressed = live.buttons.filter((button) => button.getAttribute("aria-pressed") === "true");
    const texts = (all) => all.map((each) => each.textContent);
    return { pressed: texts(pressed), labels: texts(live.labels), problem: live.problem.textContent };
  };
  do await frames(1); while (!live.settled);
  found.before = seen();
  let fail;
  Arteries.open = () => new Promise((_, no) => { fail = no; });
  live.buttons[1].click();
  await frames(3);
  found.loading = seen();
  fail(new Error("no room."));
  await frames(3);
  found.failed = seen();
  const beatless = () => { throw new Error("no beat."); };
  Arteries.open = async (...given) => Object.assign(await open(...given), { beat: beatless });
  await live.open(arterialLive.networks[1]);
  found.beatless = seen();
  Arteries.open = open;
  await live.open(arterialLive.networks[1]);
  found.there = seen();
  const parent = document.body.appendChild(document.createElement("div"));
  const other = new live.constructor(parent, { ...arterialLive, engine: "AAAA" });
  other.back.click();
  found.closed = [other.back.disabled, live.back.disabled];
  await other.open(arterialLive.networks[0]);
  found.engine = other.problem.textContent;
  tell(found);
});
"""


def page_of(script: str, driver: str, told: str, folder: Path) -> Path:
    """The beat in a page of its own, and a script that tells an address what it finds there."""
    for file in DOCS.glob("live*.js"):
        shutil.copy(file, folder)
    (folder / "live-data.js").write_text(script, encoding="utf-8")
    page = folder / "page.html"
    driver = TELLER.replace("ADDRESS", told) + driver
    page.write_text(f"<!doctype html><meta charset=utf-8>{live.block()}<script>{driver}</script>", encoding="utf-8")
    return page


def shown(page: Path, profile: Path, found: SimpleQueue[Any]) -> Any:
    """What the script of a page tells of itself, opened from its folder by a browser without a window."""
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", f"--user-data-dir={profile}")
    assert CHROMIUM is not None
    browser = subprocess.Popen([CHROMIUM, *flags, page.as_uri()], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                               start_new_session=True)  # fmt: skip
    try:
        return found.get(timeout=300)
    finally:
        os.killpg(browser.pid, signal.SIGKILL)
        browser.wait()


@pytest.fixture
def told() -> Iterator[tuple[str, SimpleQueue[Any]]]:
    """An address of this machine, and what comes there."""
    queue: SimpleQueue[Any] = SimpleQueue()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            queue.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(204)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/", queue
        server.shutdown()


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_page(data: dict[str, Any], script: str, expected: dict[str, np.ndarray], tmp_path: Path, told: Any) -> None:
    """From a folder: the numbers of the native FMU; a slider moves all curves, and Reset brings them back."""
    address, queue = told
    given = [
        [(T, [*values.items()]) for T, values in settings(name, network)]
        for name, network in zip(live.SHOWN, data["networks"], strict=True)
    ]
    driver = DRIVER.replace("BEATS", str(BEATS)).replace("SETTINGS", json.dumps(given))
    driver = driver.replace("CHANNELS", json.dumps([channels(network) for network in data["networks"]]))
    found = shown(page_of(script, driver, address, tmp_path), tmp_path / "profile", queue)
    assert "error" not in found
    for name, rows in zip(live.SHOWN, found["rows"], strict=True):
        assert off(np.array(rows), expected[name]) <= EQUAL
    assert re.fullmatch(r"A beat in \d+ steps, computed and drawn in \d+ ms\.", found["state"])
    assert len(found["first"]) == 4 and not set(found["first"]) & set(found["moved"])
    for first, again in zip(found["first"], found["reset"], strict=True):
        pixels = [np.array(re.findall(r"[\d.]+", path), float) for path in (first, again)]
        assert np.abs(pixels[0] - pixels[1]).max() <= 0.2  # a thousandth of the pulse, and a digit of the path


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_another_network_is_asked_for(script: str, tmp_path: Path, told: Any) -> None:
    """Until it is there, and if it fails, the page shows the one before, and says so; no Reset before the first."""
    address, queue = told
    found = shown(page_of(script, ASKING, address, tmp_path), tmp_path / "profile", queue)
    assert "error" not in found
    sheep, human = live.SHOWN.values()
    before, there = found["before"], found["there"]
    for each, network in ((before, sheep), (there, human)):
        assert (each["pressed"], each["problem"]) == ([network.title], "")
        assert [label.partition(":")[0] for label in each["labels"]] == [*network.sites.values()]
    assert before["labels"] != there["labels"] and found["loading"] == before
    assert found["failed"] == {**before, "problem": "Human cannot be shown: no room."}
    assert found["beatless"] == {**before, "problem": "Human cannot be shown: no beat."}
    assert found["closed"] == [True, False]
    assert found["engine"].startswith("Sheep cannot be shown: ")
