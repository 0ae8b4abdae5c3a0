"""What hearts and bodies without Python are built from: what does not fit is refused at the build."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from c_host import CHost, unpack
from fmpy.fmi1 import FMICallException
from fmus import Instance, Store
from native_fmus import needs_compiler

from build_fmu import build_model, build_native_model
from fmu_src.contents.models import FMUContents, arteries_model, body_model, heart_model
from fmu_src.native import arrays
from solver import InputError, Settings, load
from solver.lumped.arithmetic import Number, require
from solver.lumped.heart import HeartComponent
from solver.lumped.species import HUMAN_HEART

MS = 1e-3


class Demanding(HeartComponent):
    """A heart that demands steps of less than 2 ms, with a sentence of its own and ``numbers`` times the step."""

    def __init__(self, sentence: str, numbers: int) -> None:
        super().__init__(HUMAN_HEART)
        self.sentence, self.numbers = sentence, numbers

    def advance(self, t: Number, h: Number, values: Mapping[str, Any]) -> None:
        require(h < 2 * MS, self.sentence, *[h * (k + 1) for k in range(self.numbers)])
        super().advance(t, h, values)


def demanding(sentence: str, numbers: int) -> FMUContents:
    model = heart_model("human", None, 2)
    assert model.subject is not None
    return replace(model, subject=replace(model.subject, make=lambda: Demanding(sentence, numbers)))


@needs_compiler
@pytest.mark.parametrize(
    ("sentence", "numbers"),
    [("no number", 0), ("100 %% of big hearts: %g, %.3g, %.0g and %.17g s.", 4), ("%%%g%% of %%g", 1),
     ("long " * 150 + "%.17g", 1)],
)  # fmt: skip
def test_sentences(tmp_path: Path, sentence: str, numbers: int) -> None:
    """C prints what Python prints."""
    heart = Instance(build_native_model(demanding(sentence, numbers), tmp_path), tmp_path / "heart")
    heart.initialize()
    with pytest.raises(FMICallException):
        heart.slave.doStep(0.0, 3 * MS)
    assert sentence % tuple(3 * MS * (k + 1) for k in range(numbers)) in heart.messages[-1]


@needs_compiler
@pytest.mark.parametrize(
    ("sentence", "numbers", "reason"),
    [("100 % of it", 0, "only %g"), ("at the end %", 0, "only %g"), ("50 % of big hearts", 0, "only %g"),
     ("%d beats", 1, "only %g"), ("%.20g", 1, "only %g"), ("%30g", 1, "only %g"), ("%g", 0, "1 places for 0 numbers"),
     ("none", 1, "0 places for 1 numbers"), ("%g %g %g %g %g", 5, "takes up to 4")],
)  # fmt: skip
def test_sentences_that_cannot_be_printed(tmp_path: Path, sentence: str, numbers: int, reason: str) -> None:
    """Refused when the FMU is built, not when a host loads it."""
    with pytest.raises(InputError, match=re.escape(reason)):
        build_native_model(demanding(sentence, numbers), tmp_path)
    assert not list(tmp_path.iterdir())


@needs_compiler
def test_fewer_programs_are_not_enough(stored: Store, c_host: CHost, tmp_path: Path) -> None:
    """A resource without the program of the derivatives, or of the step, is damaged; with its checksum right, too."""
    fmu = unpack(stored.lumped(heart_model, fmi=2), tmp_path / "fmu")
    file = fmu.folder / "resources" / "arterial.bin"
    content = bytearray(file.read_bytes())
    meta = np.frombuffer(content, "<i4", count=5, offset=int(arrays._entries(bytes(content))[0][0]))
    assert meta[4] == 3
    found = []
    for n in (3, 2, 1):
        meta[4] = n
        file.write_bytes(arrays._sealed(bytes(content)))
        found.append(c_host.run([f"library 0 {fmu.library}", fmu.instantiate(0)])[1])
    assert [each.status for each in found] == ["ok", "null", "null"]
    assert all("arterial.bin: damaged" in each.log[0] for each in found[1:])


@pytest.mark.parametrize("make", [heart_model, body_model])
def test_documents_of_another_fmu(tmp_path: Path, make: Callable[..., FMUContents]) -> None:
    """A model whose pages say that the host needs Python is none of a native FMU, and the reverse."""
    with pytest.raises(InputError, match="make it with fmi = 2 or 3"):
        build_native_model(make(), tmp_path)
    with pytest.raises(InputError, match="make it with fmi = 0"):
        build_model(make("human", None, 2), tmp_path)
    assert not list(tmp_path.iterdir())


def test_arteries_are_no_heart(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="sheep: is neither a heart nor a body; build arteries with build_native"):
        build_native_model(arteries_model(load("sheep"), Settings()), tmp_path)
