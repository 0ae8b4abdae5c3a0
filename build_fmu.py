"""Build FMUs: ``python build_fmu.py [NETWORK] [--out dist]``, and ``heart``, ``body`` and ``system``.

The FMU is an ordinary pythonfmu archive with three precautions. All code lies under names that carry a hash of the
whole content, because a process keeps the first module of a name: two FMUs never share modules. The archive is
written with fixed dates and order, so the same input gives the same file, byte for byte. And it is written aside and
then renamed, so that no partly written FMU is ever seen.
"""

from __future__ import annotations

import ast
import io
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType

from threadpoolctl import threadpool_limits

from fmu_src import __version__, content
from fmu_src.contents import models, system
from fmu_src.contents.models import FMUContents
from fmu_src.native import native_fmu
from solver.errors import InputError
from solver.io.writing import write_folder
from solver.lumped.species import SPECIES
from solver.network.description import Network
from solver.scheme.model import Settings

ROOT = Path(__file__).resolve().parent  # with numpy and all else beside it where pip installed this
_PACKAGES = ("solver", "fmu_src")  # that an FMU brings
_EPOCH = (1980, 1, 1, 0, 0, 0)


def build(
    network: Network,
    out: str | os.PathLike[str] = "dist",
    settings: Settings | None = None,
    execution_tool: bool = True,
    starts: Mapping[str, float | str] | None = None,
) -> Path:
    """Build ``<out>/<network.name>.fmu`` and return its path.

    execution_tool : the FMI flag ``needsExecutionTool``; true as the host needs Python, but some importers refuse it.
    starts : other start values of inputs and parameters by name, such as {"inlet.interpolation": "linear"}; for hosts
    that cannot set Enumerations (ecos, libcosim).
    Raises ValueError for a start value that is not allowed, or if the directory cannot be written.
    """
    return build_model(models.arteries_model(network, settings or Settings(), starts), out, execution_tool)


def build_model(model: FMUContents, out: str | os.PathLike[str] = "dist", execution_tool: bool = True) -> Path:
    """Build ``<out>/<model.name>.fmu``, the code under names that carry a hash of the whole content.

    Raises ValueError for a model of an FMU that needs no Python, and if the directory cannot be written.
    """
    if model.fmi:
        raise InputError(f"model {model.name}: its documents are of an FMU without Python; make it with fmi = 0.")
    target = Path(out) / f"{model.name}.fmu"
    resources = {**model.resources, **_code(ROOT / "fmu_src" / f"{model.slave.replace('.', '/')}.py")}
    files = {f"resources/{path}": text.encode() for path, text in resources.items()} | model.documents
    files[content.SCRIPT] = _SCRIPT.format(model=model, name=content.NAME, guid=content.GUID).encode()
    digest = content.digest(files, execution_tool, version("pythonfmu"))
    name = content.name(digest)
    try:
        with tempfile.TemporaryDirectory(prefix="arterial_build_") as folder:
            stage = Path(folder)
            for path, text in resources.items():
                _write_text(stage / path.replace(content.PACKAGE, f"_{name}"), text)
            script = stage / f"{name}.py"
            _write_text(script, _SCRIPT.format(model=model, name=name, guid=content.guid(digest)))
            packed = _pack(script, stage, execution_tool, model.documents)
    except OSError as error:
        raise InputError(f"{target}: cannot be written ({error.strerror}); check the space on the disk.") from None
    return _written(target, packed)


def build_native(
    network: Network,
    out: str | os.PathLike[str] = "dist",
    settings: Settings | None = None,
    starts: Mapping[str, float | str] | None = None,
    fmi: int = 2,
    platforms: Sequence[str] = (),
) -> Path:
    """Build ``<out>/<network.name>.fmu`` that needs no Python on its host, and return its path.

    It contains the recorded computation, so that effects, outlets and laws may be classes of a script.
    fmi : 2 or 3, the version of the standard. platforms : of :data:`fmu_src.native.binaries.PLATFORMS`; default this
    one's.
    Raises ValueError as :func:`build`, where the network cannot be recorded, and where nothing can compile it.
    """
    with threadpool_limits(1):  # threads add in another order: the bytes would depend on their number
        files = native_fmu.files(network, settings or Settings(), starts or {}, fmi, platforms)
    return _written(Path(out) / f"{network.name}.fmu", files)


def build_native_model(model: FMUContents, out: str | os.PathLike[str] = "dist", platforms: Sequence[str] = ()) -> Path:
    """Build ``<out>/<model.name>.fmu``, a heart or a body that needs no Python on its host, and return its path.

    platforms : as for :func:`build_native`.
    Raises ValueError for a model of an FMU that needs Python or is none of a heart or a body, if the directory cannot
    be written, and where nothing can compile it.
    """
    return _written(Path(out) / f"{model.name}.fmu", native_fmu.arithmetic_files(model, platforms))


def _written(target: Path, files: dict[str, bytes]) -> Path:
    return write_folder(target.parent, {target.name: _archive(files)})[0]


def build_system(
    network: Network,
    species: str | None = None,
    out: str | os.PathLike[str] = "dist",
    execution_tool: bool = True,
    native: bool = False,
    platforms: Sequence[str] = (),
) -> Path:
    """Build ``<out>/<network.name>.ssp``: heart, arteries and body, for masters that run them side by side.

    species : of heart and body; may be left out where the network has the name of one. native, platforms : FMUs that
    need no Python on their host, as :func:`build_native` makes them.
    Raises ValueError for an unknown species, and if the directory cannot be written.
    """
    if network.inlet.causality != "flow":
        raise InputError(f"network {network.name}: a heart drives it by its flow; take inlet.causality = flow.")
    if network.further_inlets:
        raise InputError(f"network {network.name}: a heart drives one inlet; take a network without [inlets].")
    if species is None and network.name not in SPECIES:
        raise InputError(f"network {network.name}: whose heart and body? Say --species {' or '.join(SPECIES)}.")
    species, fmi = species or network.name, 2 if native else 0
    starts = system.start_values(network, *models.of(species))
    starts["heart"] |= system.first_port(network, starts["arteries"])
    made = {
        "heart": models.heart_model(species, starts["heart"], fmi),
        "arteries": models.arteries_model(network, Settings(), starts["arteries"]),
        "body": models.body_model(species, starts["body"], fmi),
    }
    parts = [system.Part(name, model.name, model.table, starts[name]) for name, model in made.items()]
    wires = system.circulation(*parts)
    files = system.files(network.name, parts, wires, 10 * network.inlet.T, __version__)
    with tempfile.TemporaryDirectory(prefix="arterial_system_") as folder:
        for name, model in made.items():
            if not native:
                fmu = build_model(model, folder, execution_tool)
            elif name == "arteries":
                fmu = build_native(network, folder, None, starts[name], fmi, platforms)
            else:
                fmu = build_native_model(model, folder, platforms)
            files[f"resources/{model.name}.fmu"] = fmu.read_bytes()
    return _written(Path(out) / f"{network.name}.ssp", files)


@cache
def _code(slave: Path) -> Mapping[str, str]:
    """The slave's module and all that it needs, by path in ``resources/``; PACKAGE stands for the hashed name."""
    files = {f"{content.PACKAGE}/__init__.py": ""}
    first = [ROOT / "fmu_src" / f"{module}.py" for module in ("host", "wrapper")]  # that the script imports itself
    for module in sorted([*_needed(slave), *first]):
        text = module.read_text(encoding="utf-8")
        # inside the FMU the two packages are neighbours in one hashed package
        path = module.relative_to(ROOT)
        text = re.sub(r"^from solver\b", f"from .{'.' * (len(path.parts) - 1)}solver", text, flags=re.MULTILINE)
        files[f"{content.PACKAGE}/{path.as_posix()}"] = text
        files |= {f"{content.PACKAGE}/{folder.as_posix()}/__init__.py": "" for folder in path.parents if folder.name}
    return MappingProxyType(files)


def _needed(module: Path) -> list[Path]:
    """A module of this project and all those that it imports, directly or through others: no files, units, terminals.

    Packages themselves are empty in an FMU.
    """
    found, todo = [], [module]
    while todo:
        file = todo.pop()
        if file in found or not file.is_file() or file.parent == ROOT:
            continue
        found.append(file)
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").partition(".")[0] in _PACKAGES):
                folder = [file, *file.parents][node.level] if node.level else ROOT
                inside = folder.joinpath(*(node.module or "").split("."))
                todo += [inside.with_suffix(".py"), *(inside / f"{alias.name}.py" for alias in node.names)]
    return sorted(found)


_SCRIPT = '''"""Slave of the model {model.name}."""

import ctypes

from _{name}.fmu_src.host import check
from _{name}.fmu_src.wrapper import mend

mend()  # before anything that may fail
check()

from _{name}.fmu_src.{model.slave} import {model.kind}

# pythonfmu's wrapper runs this file at every instantiation and then drops a reference to its namespace that it does
# not own. Where no function of the file holds one too, the namespace would be freed under the running host.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))


class BuiltSlave({model.kind}):
    code_name = "{name}"
    content_hash = "{guid}"
'''


def _write_text(file: Path, text: str) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, encoding="utf-8", newline="\n")


def _pack(script: Path, stage: Path, execution_tool: bool, documents: dict[str, bytes]) -> dict[str, bytes]:
    """The files of the FMU by path, with further ones."""
    from pythonfmu.builder import FmuBuilder

    staged = [path for path in stage.iterdir() if path != script]
    with (
        tempfile.TemporaryDirectory(prefix="arterial_pack_") as folder,
        _clean_imports(),
        redirect_stdout(io.StringIO()),
    ):
        built = FmuBuilder.build_FMU(
            script,
            dest=folder,
            project_files=staged,
            needsExecutionTool=execution_tool,
            canHandleVariableCommunicationStepSize=True,
            canGetAndSetFMUstate=True,
            canSerializeFMUstate=True,
        )
        with zipfile.ZipFile(built) as source:
            return {item: source.read(item) for item in source.namelist()} | documents


def _archive(files: dict[str, bytes]) -> bytes:
    """A ZIP archive as bytes, with fixed order and dates."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
        for item, data in sorted(files.items()):
            info = zipfile.ZipInfo(item, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            info.external_attr = 0o755 << 16 if item.startswith("binaries/") else 0o644 << 16
            packed.writestr(info, data, compresslevel=9)
    return buffer.getvalue()


@contextmanager
def _clean_imports() -> Iterator[None]:
    """Undo what the builder leaves in ``sys.path`` and ``sys.modules``; write no bytecode next to the staged files."""
    path, modules, bytecode = list(sys.path), set(sys.modules), sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        sys.path[:], sys.dont_write_bytecode = path, bytecode
        for name in set(sys.modules) - modules:
            if name.startswith(("arterial_", "_arterial_")):
                del sys.modules[name]


if __name__ == "__main__":
    import_module("arterial_fmu.__main__").main(["build", *sys.argv[1:]])
