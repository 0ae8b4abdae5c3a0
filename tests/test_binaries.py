"""The binaries of native FMUs: taken from the wheel, or compiled and kept where builds do not disturb one another; and
what a wheel without a compiler is made of."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import native_fmus
import pytest
from fmus import COARSE
from setuptools import Distribution

from fmu_src import compiler
from fmu_src.native import binaries, native_fmu
from solver import Network
from solver.errors import InputError
from solver.tracing.native import SOURCES

NAME = "aarch64-linux"  # a platform that this machine is not


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """As installed, but without libraries: the folder of the engine; the user's cache is tmp_path/cache."""
    engines = tmp_path / "site" / "solver" / "engine"
    shutil.copytree(SOURCES, engines / "sources", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    monkeypatch.setattr(binaries, "ENGINES", engines)
    monkeypatch.setattr(binaries, "SOURCES", engines / "sources")
    monkeypatch.setenv("XDG_CACHE_HOME", os.fspath(tmp_path / "cache"))
    monkeypatch.setattr(binaries.sys, "platform", "linux")
    monkeypatch.setattr(compiler, "ziglang", lambda target: ["zig", target])
    return engines


def compiling(monkeypatch: pytest.MonkeyPatch, content: Callable[[], bytes]) -> None:
    def compiled(command: Sequence[str], files: Sequence[Path], suffix: str) -> bytes:
        return content()

    monkeypatch.setattr(compiler, "compiled", compiled)


def files(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def test_the_wheel_has_it(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A library of these sources is taken as it is; of other ones it is compiled, and not written beside it."""
    compiling(monkeypatch, lambda: b"compiled")
    target = compiler.PLATFORMS[NAME].target
    brought = installed / compiler.fmu_library(NAME, binaries.sources(), target)
    brought.write_bytes(b"brought")
    assert binaries.binary(NAME) == b"brought" and not (tmp_path / "cache").exists()
    (installed / "sources" / "fmu" / "fmi2.c").write_text("int other;")
    before = files(installed)
    assert binaries.binary(NAME) == b"compiled"
    assert files(installed) == before and len(files(tmp_path / "cache" / "arterial-fmu")) == 1


def test_it_is_kept(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled once; that of earlier sources is removed, those of other platforms are not; the folder is the user's."""
    made = iter((b"first", b"second", b"third"))
    compiling(monkeypatch, lambda: next(made))
    assert [binaries.binary(name) for name in (NAME, NAME, "win64")] == [b"first", b"first", b"second"]
    (installed / "sources" / "steps.c").write_text("int other;")
    assert binaries.binary(NAME) == b"third"
    cache = tmp_path / "cache" / "arterial-fmu"
    assert sorted(name.rpartition("-")[0] for name in files(cache)) == [NAME, "win64"]
    if os.name == "posix":
        assert cache.stat().st_mode & 0o777 == 0o700


def test_another_build_removes_it(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A library that a build of other sources removes as soon as it is there."""
    compiling(monkeypatch, lambda: b"library")
    replace = os.replace

    def replaced(source: str | Path, target: str | Path) -> None:
        replace(source, target)
        Path(target).unlink()

    monkeypatch.setattr(binaries.os, "replace", replaced)
    assert binaries.binary(NAME) == b"library"


def test_builds_at_once(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four threads that compile the same library at the same time, in one process: each has it, one file stays."""
    together, found = threading.Barrier(4, timeout=60), list[bytes]()

    def content() -> bytes:
        together.wait()
        return b"library" * 1000

    compiling(monkeypatch, content)
    replace = os.replace

    def replaced(source: str | Path, target: str | Path) -> None:
        together.wait()  # all have written aside what they are about to rename
        replace(source, target)

    monkeypatch.setattr(binaries.os, "replace", replaced)
    threads = [threading.Thread(target=lambda: found.append(binaries.binary(NAME))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [b"library" * 1000] * 4
    assert len(files(tmp_path / "cache" / "arterial-fmu")) == 1


def test_no_cache(installed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the folder cannot be made, or there is no home, it is compiled each time."""
    made = iter((b"first", b"second", b"third"))
    compiling(monkeypatch, lambda: next(made))
    (tmp_path / "cache").write_text("a file")
    assert [binaries.binary(NAME), binaries.binary(NAME)] == [b"first", b"second"]

    def nobody() -> Path:
        raise RuntimeError("no home")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(binaries.Path, "home", nobody)
    assert binaries.cache() is None and binaries.binary(NAME) == b"third"


@pytest.mark.parametrize(
    ("system", "variable", "value", "expected"),
    [
        ("win32", "LOCALAPPDATA", "/l", "/l/arterial-fmu"),
        ("win32", "LOCALAPPDATA", "", "/home/me/AppData/Local/arterial-fmu"),
        ("darwin", "XDG_CACHE_HOME", "", "/home/me/Library/Caches/arterial-fmu"),
        ("linux", "XDG_CACHE_HOME", "/c", "/c/arterial-fmu"),
        ("linux", "XDG_CACHE_HOME", "", "/home/me/.cache/arterial-fmu"),
    ],
)
def test_the_users_folder(
    installed: Path, monkeypatch: pytest.MonkeyPatch, system: str, variable: str, value: str, expected: str
) -> None:
    """On every system a folder of the user's own, none that others may have made before; a checkout has its own."""
    monkeypatch.setenv(variable, value)
    monkeypatch.setattr(binaries.Path, "home", lambda: Path("/home/me"))
    monkeypatch.setattr(binaries.sys, "platform", system)
    assert binaries.cache() == Path(expected)
    monkeypatch.setattr(binaries, "SOURCES", installed.parents[1] / "native")
    assert binaries.cache() == installed


def test_nothing_can_compile_it(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence of an installation that was made without the compiler."""
    monkeypatch.setattr(compiler, "ziglang", lambda target: None)
    told = f"the published wheels of arterial-fmu bring; this installation has none for {NAME}, and the one here makes"
    with pytest.raises(InputError, match=f"{told} no binary for {NAME}: pip install ziglang"):
        binaries.binary(NAME)


@pytest.mark.parametrize(
    ("fmi", "platforms", "expected"),
    [
        (2, [*compiler.PLATFORMS], ["linux64/x.so", "aarch64-linux/x.so", "win64/x.dll", "darwin64/x.dylib"]),
        (2, ["aarch64-darwin"], ["darwin64/x.dylib"]),
        (2, ["darwin64"], ["darwin64/x.dylib"]),
        (3, [*compiler.PLATFORMS], ["x86_64-linux/x.so", "aarch64-linux/x.so", "x86_64-windows/x.dll",
                                    "x86_64-darwin/x.dylib", "aarch64-darwin/x.dylib"]),
    ],
)  # fmt: skip
def test_folders(monkeypatch: pytest.MonkeyPatch, fmi: int, platforms: list[str], expected: list[str]) -> None:
    """Where importers look: of FMI 2 in darwin64 on every Mac, with the library of the machines that were asked for."""
    monkeypatch.setattr(native_fmu, "binary", lambda name: name.encode())
    found = native_fmu.binaries("x", fmi, platforms)
    assert [*found] == [f"binaries/{path}" for path in expected]
    mac = found.get("binaries/darwin64/x.dylib", b"")
    assert all(name.encode() in mac for name in platforms if fmi == 2 and "darwin" in name)


# --- what wheels are made of ----------------------------------------------------------------------------------------


def backend() -> Any:
    spec = importlib.util.spec_from_file_location("arterial_backend", SOURCES / "arterial_backend.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def built(module: Any, folder: Path) -> Path:
    """The folder of the engine as a wheel of no packages has it; something of an earlier build was there."""
    command = module.BuildPy(Distribution({"packages": []}))
    command.ensure_finalized()
    command.build_lib = os.fspath(folder)
    (folder / "solver" / "engine").mkdir(parents=True)
    (folder / "solver" / "engine" / "linux64-0123.so").write_bytes(b"of an earlier build")
    command.run()
    return folder / "solver" / "engine"


def test_a_wheel_without_the_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the sources alone; a wheel asks for the compiler, an editable install does not."""
    module = backend()
    monkeypatch.setattr(module.compiler, "ziglang", lambda target="": None)
    made = built(module, tmp_path)
    sources = {path.relative_to(SOURCES).as_posix() for path in SOURCES.rglob("*.[ch]")}
    assert {name for name in files(made) if "." in name} == {f"sources/{name}" for name in sources}
    assert all((made / "sources" / name).read_bytes() == (SOURCES / name).read_bytes() for name in sources)
    assert any(each.startswith("ziglang") for each in module.get_requires_for_build_wheel())
    assert not any(each.startswith("ziglang") for each in module.get_requires_for_build_editable())


def test_a_wheel_with_a_compiler_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The platform for which it fails is left out; the others have the names under which they are looked for."""
    module = backend()

    def compiled(command: Sequence[str], files: Sequence[Path], suffix: str, define: str = "") -> bytes:
        if suffix == ".dll":
            raise compiler.NotCompiled("no Windows")
        return b"library"

    monkeypatch.setattr(module.compiler, "ziglang", lambda target="": ["zig", target])
    monkeypatch.setattr(module.compiler, "compiled", compiled)
    names = [name for name in files(built(module, tmp_path)) if re.search(r"\.(so|dylib|dll)$", name)]
    platforms = {name: p for name, p in compiler.PLATFORMS.items() if name != "win64"}
    assert names == sorted(
        [f"arterial_engine-{p.fmi3}{p.suffix}" for p in platforms.values()]
        + [compiler.fmu_library(name, binaries.sources(), p.target) for name, p in platforms.items()]
    )


# --- the tests' own native FMUs ---------------------------------------------------------------------------------------


def test_where_native_fmus_can_be_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a compiler only where the binary of these sources is."""
    monkeypatch.setattr(native_fmus, "ENGINES", tmp_path)
    monkeypatch.setattr(native_fmus, "here", lambda: NAME)
    monkeypatch.setattr(compiler, "ziglang", lambda: None)
    monkeypatch.setattr(compiler, "own", lambda: [["cc"]])
    assert native_fmus.can_build()
    monkeypatch.setattr(compiler, "own", lambda: [])
    assert not native_fmus.can_build()
    (tmp_path / compiler.fmu_library(NAME, binaries.sources(), compiler.PLATFORMS[NAME].target)).write_bytes(b"there")
    assert native_fmus.can_build()


@pytest.mark.skipif(not native_fmus.can_build(), reason="needs a C compiler or the binary of a wheel")
def test_the_other_fmu_is_no_way_out(
    fast_fmu: Callable[..., Path], sheep: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where native FMUs can be built, a test that asks for one fails if its builder refuses the network."""

    def refused(*_: object) -> None:
        raise InputError("refused.")

    monkeypatch.setattr(native_fmu, "files", refused)
    with pytest.raises(InputError, match="refused"):
        fast_fmu(sheep, replace(COARSE, dt=1.9e-3))  # which no other test asks for
