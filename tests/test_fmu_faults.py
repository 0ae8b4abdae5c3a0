"""Faults injected into files, folders and the host's Python: a clear sentence, and a host that lives on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from c_host import CHost, Unpacked, unpack

from fmu_src.importer.interpreter import interpreter
from fmu_src.importer.run import FMUError, run_fmu


@pytest.fixture
def whole(fmus: dict[str, Path], tmp_path: Path) -> Unpacked:
    return unpack(fmus["coarse sheep"], tmp_path / "whole")


def steps(fmu: Unpacked, i: int = 0) -> list[str]:
    """Commands of a run: instance i takes two steps, and a site's pressure is read."""
    begin = [f"library {i} {fmu.library}", fmu.instantiate(i, i), f"setup {i} 0 1", f"enter {i}", f"exit {i}"]
    inflow = f"setReal {i} {fmu.references['inlet.Q']} 1e-5"
    return [*begin, inflow, f"step {i} 0 0.01", f"step {i} 0.01 0.01", f"getReal {i} {fmu.references['CA.P']}"]


def test_truncated(fmus: dict[str, Path], tmp_path: Path) -> None:
    """An FMU cut off anywhere is refused with one sentence that names the file."""
    content = fmus["coarse sheep"].read_bytes()
    file = tmp_path / "cut.fmu"
    for length in (0, 1, 100, len(content) // 2, len(content) - 100, len(content) - 1):
        file.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"cut\.fmu: not an FMU; build one with arterial-fmu build\.") as error:
            run_fmu(file, np.zeros_like, 0.01)
        assert "\n" not in str(error.value)


def test_damaged_inside(fmus: dict[str, Path], tmp_path: Path) -> None:
    """Bytes changed within a file of the archive: refused, before anything of it runs."""
    content = bytearray(fmus["coarse sheep"].read_bytes())
    with zipfile.ZipFile(fmus["coarse sheep"]) as archive:
        start = archive.getinfo("binaries/linux64/sheep.so").header_offset
    content[start + 1000 : start + 1100] = bytes(100)
    file = tmp_path / "damaged.fmu"
    file.write_bytes(content)
    with pytest.raises(
        ValueError, match=r"damaged\.fmu: is damaged; copy it once more, or build it with arterial-fmu build"
    ):
        run_fmu(file, np.zeros_like, 0.01)


def test_no_room_to_unpack(fmus: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk while the FMU is unpacked: one sentence."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(fmpy, "extract", full)
    with pytest.raises(ValueError, match=r"cannot be unpacked to .* \(No space left on device\); set TMPDIR"):
        run_fmu(fmus["coarse sheep"], np.zeros_like, 0.01)


@pytest.mark.parametrize(
    "missing", ["network.json", "_arterial_*/solver/laws/wall.py", "_arterial_*/fmu_src/slaves/base.py"]
)
def test_missing_resource(c_host: CHost, whole: Unpacked, fmus: dict[str, Path], tmp_path: Path, missing: str) -> None:
    """No instance, and the log names what is missing. The host lives on and runs a whole FMU."""
    broken = unpack(fmus["stiff sheep"], tmp_path / "broken")
    (file,) = (broken.folder / "resources").glob(missing)
    file.unlink()
    run = c_host.run([*steps(broken)[:2], *steps(whole, 1), "free 1"])
    assert (run.code, run.errors) == (0, "")
    assert run[1].status == "null"
    (message,) = run[1].log
    assert missing.rpartition("/")[2].removesuffix(".py") in message
    assert {answer.status for answer in run.answers[2:]} == {"ok"}


def test_read_only_folder(c_host: CHost, whole: Unpacked) -> None:
    """An FMU writes nothing where it is unpacked: a folder that cannot be written gives the same answer."""
    expected = c_host.run([*steps(whole), "free 0"])
    for path in [whole.folder, *whole.folder.rglob("*")]:
        path.chmod(0o555 if path.is_dir() or path.suffix == ".so" else 0o444)
    try:
        if os.geteuid() != 0:
            found = c_host.run([*steps(whole), "free 0"])
        else:  # permissions do not hold root back
            mount = 'mount --bind "$1" "$1" && mount -o remount,ro,bind "$1" && exec "$2"'
            line = ["unshare", "-m", "sh", "-c", mount, "sh", os.fspath(whole.folder), os.fspath(c_host.program)]
            tried = ["unshare", "-m", "sh", "-c", mount, "sh", os.fspath(whole.folder), "true"]
            if shutil.which("unshare") is None or subprocess.run(tried, capture_output=True).returncode:
                pytest.skip("root cannot mount a folder read-only here")
            found = c_host.run([*steps(whole), "free 0"], line=line)
    finally:
        for path in [whole.folder, *whole.folder.rglob("*")]:
            path.chmod(0o755)
    assert (found.code, found.errors) == (0, "")
    assert found.answers == expected.answers


@pytest.mark.parametrize("numpy", ["missing", "damaged"])
def test_no_numpy(c_host: CHost, whole: Unpacked, tmp_path: Path, numpy: str) -> None:
    """A host whose Python lacks numpy: no instance, and one sentence with the Python and what to do."""
    here = interpreter()
    python = tmp_path / "bare" / "bin" / "python3"  # a virtual environment without any package
    python.parent.mkdir(parents=True)
    python.symlink_to(Path(sys.executable).resolve())
    home = Path(sys.base_prefix) / "bin"
    (tmp_path / "bare" / "pyvenv.cfg").write_text(f"home = {home}\ninclude-system-site-packages = false\n")
    environment = c_host.environment(here, PATH=f"{python.parent}:{os.environ['PATH']}")
    if numpy == "damaged":
        (tmp_path / "numpy.py").write_text("raise ImportError('a library of it is missing')\n")
        environment["PYTHONPATH"] = os.fspath(tmp_path)
    run = c_host.run([*steps(whole)[:2], "wait 0"], environment)
    assert (run.code, run.errors) == (0, "")
    assert [answer.status for answer in run.answers] == ["ok", "null", "ok"]
    (message,) = run[1].log
    assert f"Python {'.'.join(map(str, here.version))} in {tmp_path / 'bare'}" in message
    assert "-m pip install numpy" in message
    assert ("has no numpy" if numpy == "missing" else "a library of it is missing") in message


def test_driver_says_so_too(fmus: dict[str, Path], tmp_path: Path) -> None:
    """A missing resource through run_fmu: FMUError with the FMU's sentence."""
    broken = tmp_path / "sheep.fmu"
    with zipfile.ZipFile(fmus["stiff sheep"]) as source, zipfile.ZipFile(broken, "w") as target:
        for name in source.namelist():
            if not name.endswith("network.json"):  # other names, or the process may have seen the whole code
                target.writestr(
                    name.replace("arterial_", "broken_01"), source.read(name).replace(b"arterial_", b"broken_01")
                )
    with pytest.raises(FMUError, match=r"sheep\.fmu: .*network\.json"):
        run_fmu(broken, np.zeros_like, 0.01)
