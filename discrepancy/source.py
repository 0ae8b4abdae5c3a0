"""What a study starts from: a record on disk, and a model as a network file or as an FMU that carries its own."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path

from fitting.fmu_run import read_fmu, run_module
from solver.files import find_network, loads, read_network
from solver.host_died import ended
from solver.network import Network


def read_model(path: str | os.PathLike[str]) -> Network:
    """The network of a TOML file, of a bundled network's name, or of an FMU. Raises ValueError, one sentence."""
    source = Path(path)
    if source.suffix.lower() != ".fmu":
        return read_network(find_network(path))
    fmu = read_fmu(source)  # its own sentences for what is no FMU of this project
    try:
        with zipfile.ZipFile(source) as archive:
            text = archive.read("resources/network.toml").decode("utf-8")
    except KeyError:
        raise ValueError(f"{source}: it carries no network file; build it anew, or give the network file.") from None
    network = loads(text, f"{source}: network.toml")
    for name, value in {**network.parameters(), "network.elastic_law": network.elastic_law}.items():
        if fmu.starts[name] != value:
            raise ValueError(
                f"{source}: {name} starts at {fmu.starts[name]} in its description, and is {value} in its network "
                "file; build it anew, with --set where a value was changed."
            )
    return network


def build_fmu(network_file: Path, folder: Path) -> Path:
    """Build the FMU of a network file in a process of its own: ``<folder>/<name>.fmu``.

    Raises ValueError with what the process said.
    """
    code, said = run_module("build_fmu", os.fspath(network_file), "--out", os.fspath(folder))
    if code != 0:
        raise ValueError(said or f"{network_file}: its FMU could not be built; the process {ended(code)}.")
    return folder / f"{read_network(network_file).name}.fmu"
