"""What a study starts from: a record on disk, and a model as a network file or as an FMU that carries its own."""

from __future__ import annotations

import os
from pathlib import Path

from fitting.fmu_run import read_fmu, run_module
from solver.errors import InputError
from solver.files import find_network, read_network
from solver.host_died import ended
from solver.network import Network


def read_model(path: str | os.PathLike[str]) -> Network:
    """The network of a TOML file, of a bundled network's name, or of an FMU. Raises ValueError, one sentence."""
    network = read_network(find_network(path))
    if Path(path).suffix.lower() != ".fmu":
        return network
    starts = read_fmu(path).starts
    for name, value in {**network.parameters(), "network.elastic_law": network.elastic_law}.items():
        if starts[name] != value:
            raise InputError(
                f"{path}: {name} starts at {starts[name]} in its description, and is {value} in its network file; "
                "build it anew, with --set where a value was changed."
            )
    return network


def build_fmu(network_file: Path, folder: Path) -> Path:
    """Build the FMU of a network file in a process of its own: ``<folder>/<name>.fmu``.

    Raises ValueError with what the process said.
    """
    code, said = run_module("build_fmu", os.fspath(network_file), "--out", os.fspath(folder))
    if code != 0:
        raise InputError(said or f"{network_file}: its FMU could not be built; the process {ended(code)}.")
    return folder / f"{read_network(network_file).name}.fmu"
