"""Build FMUs: ``python build_fmu.py [NETWORK] [--out dist]``, and ``heart``, ``body``, ``system`` and ``doctor``.

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
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import typer
import typer.core

from fmu_src import __version__, content, doctor, models, native_fmu, system
from fmu_src.binaries import PLATFORMS
from fmu_src.models import Model
from fmu_src.species import SPECIES
from fmu_src.variable import Variable
from solver.console import faults, put, say, sentences
from solver.errors import InputError
from solver.files import find_network, read_network, write_whole
from solver.network import Network
from solver.options import DefaultGroup, Json, NetworkName, Quiet
from solver.progress import bar
from solver.scheme.model import Settings
from solver.text import assignments
from solver.writing import check_destinations

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


def build_model(model: Model, out: str | os.PathLike[str] = "dist", execution_tool: bool = True) -> Path:
    """Build ``<out>/<model.name>.fmu``, the code under names that carry a hash of the whole content."""
    target = Path(out) / f"{model.name}.fmu"
    resources = {**model.resources, **_code(ROOT / "fmu_src" / f"{model.slave}.py")}
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
            archive = _pack(script, stage, execution_tool, model.documents)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, archive)
    except OSError as error:
        raise _unwritable(target, error) from None
    return target


def build_native(
    network: Network,
    out: str | os.PathLike[str] = "dist",
    settings: Settings | None = None,
    starts: Mapping[str, float | str] | None = None,
    fmi: int = 2,
    platforms: Sequence[str] = (),
) -> Path:
    """Build ``<out>/<network.name>.fmu`` that needs no Python on its host, and return its path.

    fmi : 2 or 3, the version of the standard. platforms : of :data:`fmu_src.binaries.PLATFORMS`; default this one's.
    Raises ValueError as :func:`build`, where the network cannot be recorded, and where nothing can compile it.
    """
    target = Path(out) / f"{network.name}.fmu"
    archive = _archive(native_fmu.files(network, settings or Settings(), starts or {}, fmi, platforms))
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, archive)
    except OSError as error:
        raise _unwritable(target, error) from None
    return target


def _unwritable(target: Path, error: OSError) -> InputError:
    for folder in target.parents:
        if folder.exists() and not folder.is_dir():
            return InputError(f"{folder}: is a file, not a directory; choose another directory for {target.name}.")
    return InputError(f"{target}: cannot be written ({error.strerror}); check the directory and the space on the disk.")


def build_system(
    network: Network,
    species: str | None = None,
    out: str | os.PathLike[str] = "dist",
    execution_tool: bool = True,
) -> Path:
    """Build ``<out>/<network.name>.ssp``: heart, arteries and body, for masters that run them side by side.

    species : of heart and body; may be left out where the network has the name of one.
    Raises ValueError for an unknown species, and if the directory cannot be written.
    """
    if network.inlet.causality != "flow":
        raise InputError(f"network {network.name}: a heart drives it by its flow; take inlet.causality = flow.")
    if network.further_inlets:
        raise InputError(f"network {network.name}: a heart drives one inlet; take a network without [inlets].")
    if species is None and network.name not in SPECIES:
        raise InputError(f"network {network.name}: whose heart and body? Say --species {' or '.join(SPECIES)}.")
    species = species or network.name
    starts = system.start_values(network, *models.of(species))
    starts["heart"] |= system.first_port(network, starts["arteries"])
    made = {
        "heart": models.heart_model(species, starts["heart"]),
        "arteries": models.arteries_model(network, Settings(), starts["arteries"]),
        "body": models.body_model(species, starts["body"]),
    }
    parts = [system.Part(name, model.name, model.table, starts[name]) for name, model in made.items()]
    target = Path(out) / f"{network.name}.ssp"
    wires = system.circulation(*parts)
    files = system.files(network.name, parts, wires, 10 * network.inlet.T, __version__)
    try:
        with tempfile.TemporaryDirectory(prefix="arterial_system_") as folder:
            for model in made.values():
                fmu = build_model(model, folder, execution_tool)
                files[f"resources/{model.name}.fmu"] = fmu.read_bytes()
        target.parent.mkdir(parents=True, exist_ok=True)
        write_whole(target, _archive(files))
    except OSError as error:
        raise _unwritable(target, error) from None
    return target


@cache
def _code(slave: Path) -> Mapping[str, str]:
    """The slave's module and all that it needs, by path in ``resources/``; PACKAGE stands for the hashed name."""
    files = {f"{content.PACKAGE}{folder}/__init__.py": "" for folder in ("", "/solver", "/fmu_src")}
    first = [ROOT / "fmu_src" / f"{module}.py" for module in ("host", "wrapper")]  # that the script imports itself
    for module in sorted([*_needed(slave), *first]):
        text = module.read_text(encoding="utf-8")
        # inside the FMU the two packages are neighbours in one hashed package
        text = re.sub(r"^from solver\b", "from ..solver", text, flags=re.MULTILINE)
        files[f"{content.PACKAGE}/{module.relative_to(ROOT).as_posix()}"] = text
    return MappingProxyType(files)


def _needed(module: Path) -> list[Path]:
    """A module of this project and all those that it imports, directly or through others: no files, units, terminals.

    The solver's and the slave's packages themselves are empty in an FMU.
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
                todo += [inside / "__init__.py"] if inside.parent not in (ROOT, ROOT.parent) else []
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


def _pack(script: Path, stage: Path, execution_tool: bool, documents: dict[str, bytes]) -> bytes:
    """The FMU as bytes, with fixed order and dates, and with further files by path."""
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
            return _archive({item: source.read(item) for item in source.namelist()} | documents)


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


app = typer.Typer(
    cls=DefaultGroup,
    add_completion=False,
    rich_markup_mode=None,
    help="Build FMUs of arteries and of what they are coupled to.",
)
_SPECIES = "|".join(SPECIES)
SpeciesName = Annotated[str, typer.Option("--species", metavar=_SPECIES, help="Whose heart or body.")]
Changes = Annotated[
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help='Another start value: "heart.rate=1.3 Hz".')
]
Out = Annotated[Path, typer.Option(help="Directory of the FMU.")]
ExecutionTool = Annotated[bool, typer.Option(help="State needsExecutionTool in the FMU; some importers refuse it.")]


@app.command("network")
def main(
    network: NetworkName = "sheep",
    out: Out = Path("dist"),
    execution_tool: ExecutionTool = True,
    inlet: Annotated[
        str | None,
        typer.Option(metavar="flow|pressure", help="What drives the inlet; default as in the network file."),
    ] = None,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help='Another start value, such as "CA.phi0=0 kPa*s".'),
    ] = None,
    native: Annotated[bool, typer.Option("--native", help="An FMU that needs no Python on its host.")] = False,
    fmi: Annotated[int, typer.Option(metavar="2|3", help="With --native: version of the standard.")] = 2,
    platforms: Annotated[
        str,
        typer.Option(metavar="|".join(PLATFORMS), help="With --native: for which, by commas; default this machine."),
    ] = "",
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Build the FMU of a network of arteries; the default: the word network may be left out."""
    with sentences(), bar(quiet, "building"):
        if inlet not in (None, "flow", "pressure"):
            raise InputError(f"--inlet {inlet}: must be flow or pressure.")
        arteries = read_network(find_network(network))
        check_destinations(out / f"{arteries.name}.fmu", given=[network], folders=True)
        arteries = replace(arteries, inlet=replace(arteries.inlet, causality=inlet or arteries.inlet.causality))
        starts = _start_values(models.arteries_model(arteries, Settings()).table, change or [])
        if native:
            target = build_native(arteries, out, None, starts, fmi, [p for p in platforms.split(",") if p])
        else:
            if fmi != 2 or platforms:
                raise InputError("--fmi and --platforms: for FMUs that need no Python; add --native.")
            target = build(arteries, out, execution_tool=execution_tool, starts=starts)
    _report(target, as_json, quiet)


def _start_values(table: Iterable[Variable], changes: Sequence[str]) -> dict[str, float | str]:
    """Start values from texts such as "CA.phi0=0 kPa*s". Raises ValueError."""
    numbers = {v.name: v.quantity for v in table if v.quantity is not None}
    return assignments(changes, {name: (q.unit, q.display) for name, q in numbers.items()})


def _lumped(model: Callable[..., Model]) -> Callable[..., None]:
    """The command that builds a heart or a body."""

    def command(
        species: SpeciesName = "human",
        out: Out = Path("dist"),
        execution_tool: ExecutionTool = True,
        change: Changes = None,
        as_json: Json = False,
        quiet: Quiet = False,
    ) -> None:
        with sentences(), bar(quiet, "building"):
            known = model(species)
            check_destinations(out / f"{known.name}.fmu", folders=True)
            starts = _start_values(known.table, change or [])
            target = build_model(model(species, starts), out, execution_tool)
        _report(target, as_json, quiet)

    return command


app.command("heart", help="Build the FMU of a left heart.")(_lumped(models.heart_model))
_VEINS = "Build the FMU of the veins, which close the volume between arteries and heart."
app.command("body", help=_VEINS)(_lumped(models.body_model))


@app.command("system")
def system_command(
    network: NetworkName = "human",
    species: Annotated[
        str | None,
        typer.Option(metavar=_SPECIES, help="Whose heart and body; default as the network is called."),
    ] = None,
    out: Out = Path("dist"),
    execution_tool: ExecutionTool = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Build heart, arteries and body as one system in SSP."""
    with sentences(), bar(quiet, "building heart, arteries and body"):
        arteries = read_network(find_network(network))
        check_destinations(out / f"{arteries.name}.ssp", folders=True)
        target = build_system(arteries, species, out, execution_tool)
    _report(target, as_json, quiet)


app.command("doctor")(doctor.main)


def _report(target: Path, as_json: bool, quiet: bool) -> None:
    size = target.stat().st_size
    if as_json:
        put({"written": [str(target)], "bytes": size})
    elif not quiet:
        say(f"wrote {target} ({size / 1024:.0f} kB)")


if __name__ == "__main__":
    with faults():
        app()
