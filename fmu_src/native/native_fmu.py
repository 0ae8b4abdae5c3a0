"""The files of an FMU that needs no Python: binaries for all networks, one resource with this one's programs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from solver.errors import InputError
from solver.lumped.component import Arithmetic
from solver.network.description import Network
from solver.network.files import dumps
from solver.scheme.model import Settings

from .. import __version__
from ..contents.models import FMUContents, given_arteries
from ..documents import document
from ..slaves.arteries_slave import in_one_line
from ..variables.variable import Variable
from . import native_description
from .arrays import with_guid
from .binaries import PLATFORMS, binary, fat, here, sources
from .native_description import About
from .resource import arithmetic_resource, resource

RESOURCE, DESCRIPTION = "resources/arterial.bin", "modelDescription.xml"
_ARM = "aarch64-darwin"


def files(
    network: Network, settings: Settings, starts: Mapping[str, float | str], fmi: int, platforms: Sequence[str]
) -> dict[str, bytes]:
    """All files of arteries by path. Raises ValueError as ``build_fmu.build_native``."""
    libraries = _libraries(network.name, fmi, platforms)
    network, settings, table, _ = given_arteries(network, settings, starts)
    about = About(
        network.name, in_one_line(network), __version__, "", 5 * network.inlet.T, settings.dt, settings.tolerance
    )
    own_files = {
        "resources/network.toml": dumps(network).encode(),
        RESOURCE: resource(network, settings, table),
        **document.documents(network, table, __version__, fmi),
    }
    return _complete(about, table, own_files, fmi) | libraries


def arithmetic_files(model: FMUContents, platforms: Sequence[str]) -> dict[str, bytes]:
    """All files of a heart or a body by path. Raises ValueError as ``build_fmu.build_native``."""
    if model.subject is None:
        raise InputError(f"model {model.name}: is neither a heart nor a body; build arteries with build_native.")
    if not model.fmi:
        raise InputError(f"model {model.name}: its documents are of an FMU with Python; make it with fmi = 2 or 3.")
    libraries = _libraries(model.name, model.fmi, platforms)
    subject, component, e = model.subject, model.subject.make(), model.subject.experiment
    assert isinstance(component, Arithmetic)
    about = About(model.name, subject.description, __version__, "", e.stop_time, e.step_size, None)
    own_files = {
        **{f"resources/{path}": text.encode() for path, text in model.resources.items()},
        RESOURCE: arithmetic_resource(component, model.table),
        **model.documents,
    }
    return _complete(about, model.table, own_files, model.fmi) | libraries


def _libraries(name: str, fmi: int, platforms: Sequence[str]) -> dict[str, bytes]:
    """The libraries by path, made first: without a compiler, nothing else needs to be done."""
    if fmi not in (2, 3):
        raise InputError(f"--fmi {fmi}: must be 2 or 3.")
    if not platforms and here() is None:
        raise InputError(f"this machine is none that FMUs are built for; give --platforms, of {', '.join(PLATFORMS)}.")
    return binaries(name, fmi, list(platforms or [str(here())]))


def _complete(about: About, table: Sequence[Variable], own_files: Mapping[str, bytes], fmi: int) -> dict[str, bytes]:
    """With the contents of every FMU: sources, description, GUID."""
    found = {**own_files, **{f"sources/{path}": text for path, text in sources().items()}}
    compiled = [path for path in sources() if path.endswith(".c")]
    describe = partial(native_description.fmi2, files=compiled) if fmi == 2 else native_description.fmi3
    found[DESCRIPTION] = describe(about, table)
    found["sources/buildDescription.xml"] = native_description.build_description(about, compiled)
    guid = guid_of(found)
    found[RESOURCE] = with_guid(found[RESOURCE], guid)
    found[DESCRIPTION] = describe(replace(about, guid=guid), table)
    return found


def guid_of(found: Mapping[str, bytes]) -> str:
    """The GUID: a hash of everything, itself open, but the binaries, which follow from the sources."""
    hashes = [(path, hashlib.sha256(found[path]).hexdigest()) for path in sorted(found)]
    return f"{{{hashlib.sha256(json.dumps(hashes).encode()).hexdigest()[:32]}}}"


def binaries(name: str, fmi: int, platforms: Sequence[str]) -> dict[str, bytes]:
    """The libraries by path; FMI 2 has one folder for macOS, with the library of either machine, or of both."""
    made, found = {platform: binary(platform) for platform in platforms}, dict[str, bytes]()
    if fmi == 2 and "darwin64" in made and _ARM in made:
        made["darwin64"] = fat(made["darwin64"], made.pop(_ARM))
    for platform, content in made.items():
        p = PLATFORMS[platform]
        found[f"binaries/{p.fmi2 if fmi == 2 else p.fmi3}/{name}{p.suffix}"] = content
    return found
