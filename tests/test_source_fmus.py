"""Importers that compile the sources of a native FMU themselves."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from c_host import unpack
from fmpy import simulate_fmu
from fmus import Store
from native_fmus import needs_compiler

from build_fmu import build_native
from fmu_src import compiler
from solver import load

pytestmark = needs_compiler
OWN = {"inlet.drive": 2}


@pytest.mark.parametrize("fmi", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("with_options", [pytest.param(True, marks=pytest.mark.slow), False])
def test_compiled_by_an_importer(stored: Store, tmp_path: Path, fmi: int, with_options: bool) -> None:
    """The same numbers, to the bit, in a process that has functions with names of ours (``step`` of glibc), with the
    options of the description and, as by FMPy, without them."""
    file = stored(build_native, load("sheep"), fmi=fmi)
    expected = simulate_fmu(os.fspath(file), stop_time=0.02, start_values=OWN)
    folder = unpack(file, tmp_path).folder
    (library,) = folder.glob("binaries/*/*")
    sources = folder / "sources"
    description = ElementTree.parse(sources / "buildDescription.xml").find("BuildConfiguration/SourceFileSet")
    assert description is not None and description.get("language") == "C99"
    files = [str(sources / str(node.get("name"))) for node in description.iter("SourceFile")]
    listed = [node.get("name") for node in ElementTree.parse(folder / "modelDescription.xml").iter("File")]
    assert listed == ([node.get("name") for node in description.iter("SourceFile")] if fmi == 2 else [])
    options = ["-std=c99", *str(description.get("compilerOptions")).split()] if with_options else ["-O1"]
    line = [*compiler.own()[0], *options, "-fPIC", "-shared", *files, "-o", str(library), "-lm"]
    library.unlink()
    subprocess.run(line, check=True, capture_output=True)
    found = simulate_fmu(os.fspath(folder), stop_time=0.02, start_values=OWN)
    assert all(np.array_equal(found[name], expected[name]) for name in expected.dtype.names)
