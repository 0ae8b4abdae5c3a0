"""An FMU has one truth for everybody who opens it: what ``build --set`` changes, every reader finds."""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmus import COARSE
from test_several_inlets import fork
from typer.testing import CliRunner

from arterial_fmu.cli.build import app
from arterial_fmu.study.models import FMUModel
from arterial_fmu.study.models import read_model as study_model
from build_fmu import build, build_model, build_system
from discrepancy.find.model_source import read_model
from fitting.check.fmu_run import read_fmu
from fmu_src.contents.models import arteries_model, body_model, heart_model
from fmu_src.importer.doctor import OK, examine
from fmu_src.importer.run import run_fmu
from solver import Network, Settings, load, simulate
from solver.network.curve import Curve

# of wall, geometry, outlet, input, Enumeration, inflow and solver
CHANGES = {
    "CA.E": "6.213 MPa", "AA.L": "5 cm", "AA.R0": "9 mm", "CA.outlet.R_t": "0.4", "VA1.outlet.P_venous": "3 mmHg",
    "network.elastic_law": "regression", "inlet.Q_mean": "20 mL/s", "inlet.T": "0.6 s", "solver.dt": "2 ms",
    "solver.element_length": "10 cm", "inlet.interpolation": "linear", "fluid.nu": "4e-6 m^2/s",
}  # fmt: skip


def descriptions(fmu: Path) -> dict[str, Any]:
    """The start values in the model description, of an Enumeration the name of its item."""
    return dict(read_fmu(fmu).starts)


def carried(fmu: Path, file: str) -> Any:
    with zipfile.ZipFile(fmu) as archive:
        return json.loads(archive.read(f"resources/{file}"))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set")
    line = [word for name, value in CHANGES.items() for word in ("--set", f"{name}={value}")]
    done = CliRunner().invoke(app, ["sheep", *line, "--out", os.fspath(folder), "-q"])
    assert done.exit_code == 0, done.output
    return folder / "sheep.fmu"


def test_description_and_network_file_agree(fmu: Path) -> None:
    """Bit for bit, in all parameters and laws; a study starts from the description, discover from the network file."""
    network, starts = read_model(fmu), descriptions(fmu)
    assert network.parameters() == {name: starts[name] for name in network.parameters()}
    assert (network.elastic_law, network.viscous_law) == (starts["network.elastic_law"], starts["network.viscous_law"])
    assert (network.inlet.Q_mean, network.inlet.T) == (starts["inlet.Q_mean"], starts["inlet.T"])
    assert (network.segment("CA").E, network.segment("AA").L, network.elastic_law) == (6.213e6, 0.05, "regression")
    assert network.inlet.Q_mean == pytest.approx(20e-6, rel=1e-14)
    model = study_model(os.fspath(fmu), "sheep", "1 ms", "5 cm", 1e-3)
    assert isinstance(model, FMUModel)
    assert {name: starts[name] for name in model.nominal} == dict(model.nominal)
    assert model.nominal["CA.E"] == 6.213e6
    data = carried(fmu, "network.json")
    assert data["starts"] == {"inlet.interpolation": "linear"}
    assert (data["settings"]["dt"], data["settings"]["element_length"]) == (2e-3, 0.1)


def test_the_fmu_itself(fmu: Path) -> None:
    """What runs is what is written: the direct solver on the network that is read back, to 1e-9; so says the doctor."""
    network = read_model(fmu)
    expected = simulate(network, None, 0.1, settings=Settings(dt=2e-3, element_length=0.1))
    found = run_fmu(fmu, None, 0.1, step=2e-3)
    for name in network.output_units():
        assert np.abs(found[name] - expected[name]).max() <= 1e-9 * np.ptp(expected[name]), name
    assert next(finding for finding in examine(fmu) if finding.what == "contents").state == OK


def test_values_as_in_the_network_change_nothing(sheep: Network, fmus: dict[str, Path], tmp_path: Path) -> None:
    """Set to what they are, start values give the same file, byte for byte."""
    starts = {"CA.E": sheep.segment("CA").E, "network.elastic_law": "beta", "inlet.T": sheep.inlet.T}
    assert build(sheep, tmp_path, COARSE, starts=starts).read_bytes() == fmus["coarse sheep"].read_bytes()


def test_several_inlets() -> None:
    """Means of a flow and of a pressure, and the one period: in the network that the FMU carries."""
    network = fork()
    curve = Curve("P", (0.0, 0.2, 0.5), (0.0, 900.0, 0.0))
    network = replace(network, further_inlets=(replace(network.further_inlets[0], causality="pressure", curve=curve),))
    starts = {"inlet.Q_mean": 5e-6, "B.inlet.P_mean": 700.0, "inlet.T": 0.4}
    model = arteries_model(network, COARSE, starts)
    found = {variable.name: variable.start for variable in model.table}
    assert {name: found[name] for name in starts} == pytest.approx(starts, rel=1e-14)
    inlets = json.loads(model.resources["network.json"])["network"]
    assert inlets["further_inlets"][0]["curve"]["t"][-1] == inlets["inlet"]["T"] == 0.4


@pytest.mark.parametrize("kind", [heart_model, body_model])
def test_heart_and_body(kind: Any, tmp_path: Path) -> None:
    """Their numbers are in the data that they carry, and in the description; the rest are start values."""
    heart = kind is heart_model
    values = {"heart.rate": 1.5, "aorta.P_0": 9e3} if heart else {"body.C": 2e-7, "body.exchange": "start"}
    built = build_model(kind("human", values), tmp_path)
    with zipfile.ZipFile(built) as archive:
        data = json.loads(archive.read(f"resources/{'heart' if heart else 'body'}.json"))
    own, other = values
    assert data["starts"] == {other: values[other]}
    assert (data["heart"]["heart"]["rate"] if heart else data["body"]["body"]["C"]) == values[own]
    description = fmpy.read_model_description(os.fspath(built))
    assert float(next(v for v in description.modelVariables if v.name == own).start) == values[own]
    if heart:
        assert float(description.defaultExperiment.stopTime) == pytest.approx(5 / 1.5)


def test_system(tmp_path: Path) -> None:
    """The arteries in an SSP: their network file has the outlets that the description and the parameter set have."""
    with zipfile.ZipFile(build_system(load("human"), out=tmp_path)) as archive:
        (tmp_path / "arteries.fmu").write_bytes(archive.read("resources/human.fmu"))
        ssv = archive.read("resources/arteries.ssv").decode()
    network = read_model(tmp_path / "arteries.fmu")
    outlet = network.outlets[0]
    assert outlet.C == pytest.approx(2.0 * load("human").outlets[0].C)  # type: ignore[attr-defined]
    assert f'name="{outlet.segment}.outlet.C"' in ssv and repr(outlet.C) in ssv  # type: ignore[attr-defined]


def test_one_that_disagrees_is_refused(fmu: Path, tmp_path: Path) -> None:
    """An FMU with another network file than its description says, as earlier versions built: one sentence."""
    other = tmp_path / "other.fmu"
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(other, "w") as target:
        for name in source.namelist():
            text = source.read(name)
            target.writestr(name, text.replace(b"6213000.0 Pa", b"4142000.0 Pa") if name.endswith(".toml") else text)
    with pytest.raises(
        ValueError, match=r"CA\.E starts at 6213000\.0 in its description, and is 4142000\.0 in its net"
    ):
        read_model(other)


def test_refused_values(tmp_path: Path) -> None:
    """What fits no network is refused when it is built, with the network's own sentence."""
    for text, said in (("CA.E=-1 Pa", "must lie"), ("network.elastic_law=cubic", "must be one of beta, regression")):
        done = CliRunner().invoke(app, ["sheep", "--set", text, "--out", os.fspath(tmp_path)])
        assert done.exit_code == 2 and said in done.stderr
