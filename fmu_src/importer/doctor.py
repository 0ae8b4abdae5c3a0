"""Check whether an FMU of this project runs here, and list what is missing: ``arterial-fmu doctor MODEL.fmu``.

Exit code 0: it runs. 1: it is complete but does not run here, or not in every host; the table gives the reason. 2: the
file is not a complete FMU of this project. No file content makes the doctor fail.
"""

from __future__ import annotations

import json
import lzma
import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from solver.errors import InputError
from solver.io.exit_codes import ExitCode
from solver.io.exit_codes import ended as died

from .. import content
from ..cosimulation.drive import DRIVES
from ..host import PYTHONS, TESTED
from ..native.arrays import with_guid
from ..native.binaries import PLATFORMS, here
from ..native.native_fmu import DESCRIPTION, RESOURCE, guid_of
from . import trial
from .interpreter import Interpreter, interpreter
from .unpacking import places, undecoded, unpacking_folder

OK, NOTE, PROBLEM, FATAL = "ok", "note", "problem", "no FMU of this project"
EXIT = {
    OK: ExitCode.DONE,
    NOTE: ExitCode.DONE,
    PROBLEM: ExitCode.DOES_NOT_RUN,
    FATAL: ExitCode.BAD_INPUT,
}
_PLATFORMS = {"linux64": "Linux", "win64": "Windows", "darwin64": "macOS"}
_OTHER = "is not an FMU of this project"
_WHOLE = "built by this project; code and data match the GUID"
_CHANGED = "code or data were changed after the FMU was built (GUID)"
_ANEW = "build it anew with arterial-fmu build, or copy it once more"
START, INSTALL = "start them with: ", "install it with: "
_LARGEST = 200e6  # bytes unpacked; an FMU of this project has one
_PATIENCE = 120.0  # s for the trial
# errors of zipfile for archives that are damaged, encrypted or in an unsupported format
_UNREADABLE = (zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, EOFError, ValueError, OverflowError,
               LookupError,
               MemoryError, struct.error)  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """The result of one check: its name, its state (ok, note, problem, or no FMU), the finding, and the remedy."""

    what: str
    state: str
    found: str
    remedy: str = ""


@dataclass(frozen=True)
class Archive:
    """The content of an FMU: its files, and from its description the model, GUID, flags and Pythons.

    inflow : the default drive of arteries, "input" or "network"; "" for other FMUs.
    """

    names: tuple[str, ...]
    size: int
    model: str
    guid: str
    execution_tool: bool
    python: str
    inflow: str
    fmi3: bool


def examine(fmu: str | os.PathLike[str], python: str = sys.executable) -> list[Finding]:
    """All findings about an FMU and the Python that will run it. Never raises, whatever the file is."""
    path = Path(fmu)
    try:
        archive = _archive(path)
    except _NoFMU as reason:
        return [Finding("file", FATAL, *reason.args)]
    findings = [Finding("file", OK, f"{len(archive.names)} files, {archive.size / 1000:.0f} kB, checksums right")]
    if RESOURCE in archive.names:
        findings += [*_native(path, archive), *_drive(archive)]
        whole = all(finding.state == OK for finding in findings)
        return findings + ([_trial(path, sys.executable, "report it, with this table")] if whole else [])
    findings.append(_made_here(path, archive))
    if findings[-1].found == _OTHER:
        return findings  # the rest concerns FMUs of this project
    findings += [*_drive(archive), *_binaries(archive)]
    if archive.execution_tool:
        remedy = "for importers that reject it (PyFMI), build with --no-execution-tool"
        findings.append(Finding("execution tool", NOTE, "the FMU requires Python on the host", remedy))
    try:
        where = interpreter(python)
    except InputError as error:
        return [*findings, Finding("Python", PROBLEM, str(error))]
    findings += [*_python(where, archive.python), _numpy(where), *_host(where), *_paths(path)]
    if not any(finding.state == FATAL for finding in findings):
        known = any(finding.state == PROBLEM for finding in findings)
        findings.append(
            _trial(path, where.command, "correct the problems above" if known else "report it, with this table")
        )
    return findings


def state(findings: list[Finding]) -> str:
    """The worst state of all findings."""
    return max((finding.state for finding in findings), key=list(EXIT).index)


# --- the file -------------------------------------------------------------------------------------------------------


class _NoFMU(Exception):
    """The file is not an FMU; carries the finding and the remedy."""

    def __init__(self, found: str, remedy: str = _ANEW) -> None:
        super().__init__(found, remedy)


def _archive(path: Path) -> Archive:
    """The FMU's contents. Raises _NoFMU."""
    names: tuple[str, ...] = ()
    try:
        with zipfile.ZipFile(path) as file:
            unpacked = sum(info.file_size for info in file.infolist())
            if unpacked > _LARGEST:
                raise _NoFMU(f"holds {unpacked / 1e6:.0f} MB; an FMU of this project has below {_LARGEST / 1e6:.0f} MB")
            damaged = file.testzip()
            if damaged is not None:
                raise _NoFMU(f"{damaged} is damaged (checksum)")
            names = tuple(file.namelist())
            outside = [n for n in names if PurePosixPath(n).is_absolute() or ".." in PurePosixPath(n).parts]
            if outside:
                raise _NoFMU(f"{outside[0]!r} would be written outside the folder", "do not use this file")
            root = ElementTree.fromstring(file.read("modelDescription.xml"))
    except FileNotFoundError:
        raise _NoFMU("there is no such file", "check the path, or build it with arterial-fmu build") from None
    except IsADirectoryError:
        raise _NoFMU("is a folder", "give the FMU itself, a file that ends in .fmu") from None
    except OSError as error:
        raise _NoFMU(f"cannot be read ({error.strerror or error})", "check the path and its permissions") from None
    except zipfile.BadZipFile:
        raise _NoFMU("is not an FMU, or is truncated (not a zip archive)") from None
    except KeyError:
        if "SystemStructure.ssd" in names:
            raise _NoFMU("is a system of FMUs (SSP)", "unpack it and ask about resources/*.fmu") from None
        raise _NoFMU("is not an FMU (no modelDescription.xml)") from None
    except ElementTree.ParseError as error:
        raise _NoFMU(f"modelDescription.xml is damaged ({error})") from None
    except _UNREADABLE as error:
        raise _NoFMU(f"cannot be unpacked ({type(error).__name__}: {error})") from None
    simulation = root.find("CoSimulation")
    fmi3 = root.get("fmiVersion") == "3.0" and RESOURCE in names
    if root.tag != "fmiModelDescription" or not (fmi3 or root.get("fmiVersion") == "2.0") or simulation is None:
        raise _NoFMU("is not an FMU for co-simulation by FMI 2.0", "build one with arterial-fmu build")
    model = simulation.get("modelIdentifier", "")
    if not model or any(letter in model for letter in "/\\\0"):
        raise _NoFMU("modelDescription.xml has no usable modelIdentifier")
    execution_tool = simulation.get("needsExecutionTool") in ("true", "1")
    host = root.find("VendorAnnotations/Tool[@name='arterial-fmu']/Host")
    python = "" if host is None else f"Python {host.get('python')} with {host.get('packages')}"
    guid = root.get("instantiationToken" if fmi3 else "guid", "")
    return Archive(names, path.stat().st_size, model, guid, execution_tool, python, _inflow(root), fmi3)


def _inflow(root: ElementTree.Element) -> str:
    variable = root.find("ModelVariables/ScalarVariable[@name='inlet.drive']/Enumeration")
    variable = root.find("ModelVariables/Enumeration[@name='inlet.drive']") if variable is None else variable
    start = "" if variable is None else variable.get("start", "")
    return dict(zip("12", DRIVES, strict=True)).get(start, "")


def _drive(archive: Archive) -> Iterator[Finding]:
    """The behaviour of arteries in a host that sets no inflow."""
    if archive.inflow == "input":
        found = "an input: a host that never sets inlet.Q (or inlet.P) runs at rest"
        yield Finding("inflow", OK, found, "for a first run set inlet.drive = network (2): the file's own inflow")
    elif archive.inflow == "network":
        yield Finding(
            "inflow",
            OK,
            "the network's own; inlet.Q (or inlet.P) is ignored",
            "set inlet.drive = input (1) to drive it",
        )


def _made_here(path: Path, archive: Archive) -> Finding:
    """Check that the code and data of the FMU match its GUID, and that all of them exist."""
    with zipfile.ZipFile(path) as file:
        files = {name: file.read(name) for name in archive.names if not name.startswith("binaries/")}
    module = files.get("resources/slavemodule.txt", b"").decode("utf-8", "replace").strip()
    if not re.fullmatch(r"arterial_[0-9a-f]{8}", module):
        return Finding("contents", FATAL, _OTHER, "build one with arterial-fmu build")
    missing = _missing(files, module)
    if missing:
        return Finding("contents", FATAL, f"{missing} is missing", _ANEW)
    wrapper = re.search(rb'"(.*)"', files["resources/pythonfmu/_version.py"])
    version = wrapper[1].decode("utf-8", "replace") if wrapper else ""
    inside = content.without_names(files, module, archive.guid)
    # a user may change this flag by hand for an importer: it is still the same FMU
    digests = [content.digest(inside, flag, version) for flag in (True, False)]
    if not any(archive.guid == content.guid(digest) and module == content.name(digest) for digest in digests):
        return Finding("contents", FATAL, _CHANGED, _ANEW)
    return Finding("contents", OK, f"{archive.model}, {_WHOLE}")


def _missing(files: Mapping[str, bytes], module: str) -> str | None:
    """The first missing file that the FMU's code needs: the script, or an imported module."""
    package = f"resources/_{module}"
    for name in (f"resources/{module}.py", f"{package}/__init__.py", "resources/pythonfmu/_version.py"):
        if name not in files:
            return name
    for name, text in files.items():
        if not (name.startswith(package) and name.endswith(".py")):
            continue
        for dots, inside in re.findall(rb"^from (\.+)([\w.]+) import", text, flags=re.MULTILINE):
            needed = PurePosixPath(name).parents[len(dots) - 1] / inside.decode("ascii", "replace").replace(".", "/")
            if f"{needed}.py" not in files and f"{needed}/__init__.py" not in files:
                return f"{needed}.py"
    return None


def _binaries(archive: Archive) -> Iterator[Finding]:
    """The platforms with a binary in the FMU; this machine's must be among them."""
    found = {PurePosixPath(name).parts[1] for name in archive.names if re.match(r"binaries/[^/]+/.", name)}
    here = trial.binary(Path(), archive.model)
    listed = ", ".join(_PLATFORMS.get(name, name) for name in sorted(found)) or "none"
    absent = [_PLATFORMS[name] for name in _PLATFORMS if name not in found]
    if here.as_posix() not in archive.names:
        remedy = f"the wrapper pythonfmu has no binary for {here.parent.name}: run the FMU on another machine"
        yield Finding("binary", PROBLEM, f"{here.as_posix()} is missing (there is {listed})", remedy)
    elif platform.machine().lower() not in ("x86_64", "amd64"):
        remedy = "run the host as x86-64, for example under emulation"
        yield Finding("binary", PROBLEM, f"for x86-64, but this machine is {platform.machine()}", remedy)
    else:
        without = f"; none for {' and '.join(absent)}" if absent else ""
        yield Finding("binary", OK, f"{listed}{without}; tested on Linux")


# --- the Python -----------------------------------------------------------------------------------------------------


def _python(where: Interpreter, asked: str) -> Iterator[Finding]:
    found = f"{where.name}, {where.executable}" + (f"; the FMU asks for {asked}" if asked else "")
    if where.bits != 64 or where.version[:2] < TESTED[0]:
        yield Finding("Python", PROBLEM, found, f"use a 64-bit Python {PYTHONS}")
    elif where.version[:2] > TESTED[1]:
        yield Finding("Python", NOTE, found, f"tested are {PYTHONS}")
    else:
        yield Finding("Python", OK, found)


def _numpy(where: Interpreter) -> Finding:
    if where.numpy is not None:
        return Finding("numpy", OK, f"numpy {where.numpy} in {where.numpy_from}")
    return Finding("numpy", PROBLEM, where.numpy_from, f"{INSTALL}{shlex.quote(where.executable)} -m pip install numpy")


def _host(where: Interpreter) -> Iterator[Finding]:
    """How a host that is not written in Python finds this Python."""
    label = "hosts in C, C++, …"
    if sys.platform == "win32":
        remedy = f"put {os.path.dirname(where.executable)} (python3.dll) on the PATH of the host"
        yield Finding(label, NOTE, "the wrapper loads python3.dll", remedy)
    elif where.library is None:
        remedy = "use a Python with a shared library: Debian's libpython3.x, conda, or one built with --enable-shared"
        yield Finding(label, PROBLEM, "this Python has no libpython to load; hosts in Python run", remedy)
    else:
        line = " ".join(f"{name}={_shell(value)}" for name, value in where.environment().items())
        yield Finding(label, OK, f"libpython: {where.library}", f"{START}{line} HOST")


def _shell(value: str) -> str:
    """A value quoted for the shell, with $PATH still expanded."""
    quoted = shlex.quote(value.replace("$PATH", ""))
    return quoted if "$PATH" not in value else f"{quoted}$PATH"


def _paths(path: Path) -> Iterator[Finding]:
    """Check paths: hosts pass the resource folder as a URI, and the wrapper decodes only blanks in it."""
    temporary = next(places())  # only Python uses another one if this one is not writable
    for label, folder in (("temporary folder", temporary), ("folder of the FMU", path.absolute().parent)):
        bad = "".join(sorted(set(undecoded(folder))))
        if bad:
            remedy = "set TMPDIR to a folder without them" if folder == temporary else "unpack the FMU elsewhere"
            remedy += "; letters, digits, blanks and - . _ ~ are safe"
            yield Finding(label, PROBLEM if folder == temporary else NOTE, f"{folder} holds {bad}: hosts crash", remedy)
    if not (temporary.is_dir() and os.access(temporary, os.W_OK)):
        yield Finding("temporary folder", PROBLEM, f"{temporary} cannot be written", "set TMPDIR to one that can")
    elif shutil.disk_usage(temporary).free < 10e6:
        yield Finding("temporary folder", PROBLEM, f"{temporary} has less than 10 MB left", "make room, or set TMPDIR")


def _trial(path: Path, python: str, remedy: str) -> Finding:
    """One step in a new process; remedy : the remedy if it fails."""
    label = "one step"
    try:
        with unpacking_folder("doctor_") as folder:
            with zipfile.ZipFile(path) as file:
                file.extractall(folder)
            line = [python, os.fspath(Path(trial.__file__).resolve()), folder]
            done = subprocess.run(line, capture_output=True, cwd=folder, timeout=_PATIENCE)
    except subprocess.TimeoutExpired:
        return Finding(label, PROBLEM, f"not done within {_PATIENCE:.0f} s", remedy)
    except (OSError, zipfile.BadZipFile, zlib.error, RuntimeError, ValueError) as error:
        return Finding(label, PROBLEM, f"could not be tried ({error})", "check the temporary folder, or set TMPDIR")
    reported = _json_lines(done.stdout)
    if done.returncode == 0 and {"done": "free"} in reported:
        return Finding(label, OK, "loaded, initialized, stepped, read, freed")
    reached = [line["done"] for line in reported if "done" in line]
    messages = [line["said"].splitlines()[-1] for line in reported if line.get("said", "").strip()]
    reason = (
        messages[-1]
        if messages
        else (done.stderr.decode("utf-8", "replace").strip().splitlines() or ["no message"])[-1]
    )
    ended = f"the process {died(done.returncode)}" if done.returncode < 0 else reason
    return Finding(label, PROBLEM, f"failed after {reached[-1] if reached else 'the start'}: {ended}", remedy)


def _json_lines(output: bytes) -> list[dict[str, str]]:
    lines = []
    for line in output.decode("utf-8", "replace").splitlines():
        try:
            lines.append(json.loads(line))
        except ValueError:
            continue
    return [line for line in lines if isinstance(line, dict)]


# --- an FMU that needs no Python --------------------------------------------------------------------------------------


def _native(path: Path, archive: Archive) -> Iterator[Finding]:
    """Contents, Python and binaries."""
    try:
        made = guid_of(_unnamed(path, archive)) == archive.guid
    except (ValueError, IndexError, KeyError, zipfile.BadZipFile):
        made = False
    if made:
        yield Finding("contents", OK, f"{archive.model}, {_WHOLE}")
    else:
        remedy = "build it anew with arterial-fmu build --native, or copy it once more"
        yield Finding("contents", FATAL, _CHANGED, remedy)
    yield Finding("Python", OK, "not needed by the host")
    inside = (name.split("/") for name in archive.names if name.startswith("binaries/"))
    found = sorted({parts[1] for parts in inside if len(parts) == 3})
    name = here() or ""
    mine = PLATFORMS.get(name)
    listed = ", ".join(found) or "none"
    if mine is not None and (mine.fmi3 if archive.fmi3 else mine.fmi2) in found:
        yield Finding("binary", OK, f"{listed}; tested on Linux x86-64")
    else:
        remedy = f"build it with --platforms {name}" if name else "compile sources/ for this machine"
        yield Finding("binary", PROBLEM, f"none for this machine (there is {listed})", remedy)


def _unnamed(path: Path, archive: Archive) -> dict[str, bytes]:
    """The files as they were before the GUID was known."""
    with zipfile.ZipFile(path) as file:
        found = {name: file.read(name) for name in archive.names if not name.startswith("binaries/")}
    found[RESOURCE] = with_guid(found[RESOURCE], "")
    found[DESCRIPTION] = found[DESCRIPTION].replace(archive.guid.encode(), b"")
    return found
