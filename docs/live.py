"""The beat on the first page of the site: the engine as WebAssembly and two networks, as one script of data.

The C files are those of native FMUs, and a network is the resource of its native FMU (``fmu_src/native/resource.py``):
from parameters to waves the page runs what the FMU runs. ``live-arteries.js`` is its host, ``live.js`` what one sees.
"""

from __future__ import annotations

import base64
import json
import subprocess
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fmu_src import compiler
from fmu_src.contents.models import given_arteries
from fmu_src.native.arrays import number_of
from fmu_src.native.resource import resource
from solver import Settings, load
from solver.network.description import Network

NATIVE = Path(__file__).resolve().parents[1] / "native"
TARGET = "wasm32-wasi"
# what the page calls; of the standard's own functions it has none
_CALLED = ("new", "said", "reset", "set_up", "enter", "leave", "read", "write", "step")
_HOST = {"fmi2.c", "fmi3.c", "host.c"}
ABSENT = (
    "*Here a sheep and a human beat while you move sliders, if the package ziglang was there when the site was built: "
    "`pip install ziglang`, then `make docs`.*"
)
ABOUT = (
    "Each slider acts on all arteries or all outlets; the heart rate leaves the mean inflow as it is. What runs here "
    "is the [engine of the native FMU](numerics.md#in-a-browser)."
)
NO_SCRIPT = "Here a sheep and a human beat while you move sliders, if the browser runs scripts."
STEPS = 200  # of a beat, at any heart rate


@dataclass(frozen=True)
class Slider:
    """A number that moves several parameters. kind : how, a factor or a shift of each. log : even in its logarithm."""

    label: str
    kind: str
    low: float
    high: float
    keys: tuple[str, ...]
    log: bool = False


@dataclass(frozen=True)
class Shown:
    """A network on the page. sites : name and words, of two. rates : of the heart, lowest and highest [1/min]."""

    title: str
    sites: Mapping[str, str]
    rates: tuple[int, int]
    outlets: Slider

    @property
    def settings(self) -> Settings:
        """With a time step that is the longest of the page, so that none is cut into several."""
        return Settings(dt=60.0 / self.rates[0] / STEPS)


WALLS = (
    Slider("Modulus E", "factor", 0.5, 2.0, ("E",), log=True),
    Slider("Wall viscosity φ0", "factor", 0.0, 3.0, ("phi0",)),
)
SHOWN = {
    "sheep": Shown(
        "Sheep",
        {"PD": "proximal descending aorta (PD)", "DD": "distal descending aorta (DD)"},
        (60, 180),
        Slider("Reflection R_t", "shift", -0.3, 0.5, ("outlet.R_t",)),
    ),
    "human": Shown(
        "Human",
        {"TA1": "thoracic aorta (TA1)", "AB2": "abdominal aorta (AB2)"},
        (45, 120),
        Slider("Resistance R2", "factor", 0.5, 1.5, ("outlet.R2",)),
    ),
}


def block() -> str:
    """What the page has: the live beat, or without a compiler why it is not there."""
    if compiler.ziglang() is None:
        return ABSENT
    scripts = "".join(f'<script src="{name}.js" defer></script>' for name in ("live-data", "live-arteries", "live"))
    return f'<div class="arterial-live"><noscript>{NO_SCRIPT}</noscript></div>{scripts}\n\n{ABOUT}'


def script() -> str:
    """The data of ``live.js``, nothing without a compiler."""
    if compiler.ziglang() is None:
        return ""
    made = {"engine": _packed(engine()), "networks": [network_data(name, shown) for name, shown in SHOWN.items()]}
    return f"globalThis.arterialLive = {json.dumps(made, ensure_ascii=False)};\n"


def engine() -> bytes:
    """The C files of native FMUs without FMI as a WebAssembly module. Raises CalledProcessError."""
    sources = [NATIVE / path for path in compiler.fmu_sources(NATIVE) if path.endswith(".c")]
    files = [str(path) for path in sources if path.name not in _HOST]
    flags = [flag for flag in compiler.FLAGS if flag != "-shared"]
    exports = [f"-Wl,--export={name}" for name in ("malloc", *(f"component_{name}" for name in _CALLED))]
    with tempfile.TemporaryDirectory(prefix="arterial_live_") as folder:
        out = Path(folder, "engine.wasm")
        command = [*(compiler.ziglang(TARGET) or []), *flags, "-mexec-model=reactor", *exports, *files, "-o", str(out)]
        subprocess.run(command, check=True)
        return out.read_bytes()


def network_data(name: str, shown: Shown) -> dict[str, Any]:
    """A network with what the page must know of it: where it writes and reads, and the inflow of a beat [m³/s]."""
    network, settings, table, _ = given_arteries(load(name), shown.settings, {})
    vr = {variable.name: i for i, variable in enumerate(table)}
    T = network.inlet.T
    set_first = {"inlet.interpolation": "linear", "network.start": "periodic"}
    return {
        "title": shown.title,
        "resource": _packed(resource(network, settings, table)),
        "T": T,
        "rates": shown.rates,
        "first": [[vr[key], number_of(table[vr[key]], value)] for key, value in set_first.items()],
        "inlet": vr["inlet.Q"],
        "inflow": network.inlet.Q(np.arange(1, STEPS + 1) / STEPS * T).tolist(),
        "sites": [{"label": label, "P": vr[f"{site}.P"], "Q": vr[f"{site}.Q"]} for site, label in shown.sites.items()],
        "sliders": [_slider(slider, network, vr) for slider in (*WALLS, shown.outlets)],
    }


def _slider(slider: Slider, network: Network, vr: Mapping[str, int]) -> dict[str, Any]:
    values = network.parameters()
    moved = [name for name in values if name.partition(".")[2] in slider.keys]
    return {
        "label": slider.label,
        "kind": slider.kind,
        "low": slider.low,
        "high": slider.high,
        "log": slider.log,
        "vr": [vr[name] for name in moved],
        "start": [values[name] for name in moved],
    }


def _packed(content: bytes) -> str:
    return base64.b64encode(zlib.compress(content, 9)).decode()
