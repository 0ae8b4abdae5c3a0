"""The output files of a command: check that they can be written, before the work; then write all of them or none."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from ..errors import InputError
from .interrupts import interrupts_later

Name = str | os.PathLike[str]
Content = str | bytes


def write_whole(path: Name, content: Content) -> None:
    """Write a file whole or not at all. Raises ValueError if it cannot be written."""
    write_all({path: content})


def write_all(files: Mapping[Name, Content] | Mapping[Path, Content], gone: Iterable[Path] = ()) -> None:
    """Write files by path, all of them or none: first all under temporary names, then rename each, in order.

    The last file marks a complete result: it never exists beside files of an earlier result.
    gone : files of an earlier result to remove. Raises ValueError if one cannot be written.
    """
    asides: dict[Path, Path] = {}
    path: Name = ""
    try:
        for path, content in files.items():
            _check_regular(Path(path))
            target = Path(path).resolve()  # a link stays a link
            if target in asides:
                raise InputError(f"{path}: two files have this name; give another for one of them.")
            asides[target] = target.with_name(f".{target.name}.{os.getpid()}.part")
            asides[target].write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        with interrupts_later():
            for old in (*gone, *list(asides)[1:][-1:]):
                old.unlink(missing_ok=True)
            for path, aside in asides.items():
                os.replace(aside, path)
    except OSError as error:
        raise _unwritable(Path(path), error) from None
    finally:
        for aside in asides.values():
            with suppress(OSError):
                aside.unlink()


def write_folder(folder: Name, files: Mapping[str, Content], gone: Iterable[str] = ()) -> list[Path]:
    """Write the files of a result by their names in a folder, all or none; return the written paths.

    A missing folder is created. gone : files of an earlier result to remove. Raises ValueError if one cannot be
    written.
    """
    root = Path(folder)
    paths = {root / name: content for name, content in files.items()}
    places = {path.parent for path in paths}
    made = sorted({each for place in places for each in (place, *place.parents) if not each.exists()})
    try:
        for place in places:
            make_folder(place)
        write_all(paths, [root / name for name in gone])
    except BaseException:
        for place in reversed(made):
            with suppress(OSError):  # not there yet, or not empty
                place.rmdir()
        raise
    return list(paths)


def make_folder(path: Name) -> Path:
    """The folder, created if it is missing. Raises ValueError if it cannot be created."""
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _check_way(folder)
        raise InputError(f"{folder}: cannot be made ({error.strerror}); give another folder.") from None
    return folder


def check_destinations(*paths: Path | None, given: Iterable[Name | None] = (), folders: bool = False) -> None:
    """Raise ValueError before the work, not after it, if one of the files cannot be written.

    None means no file. given : the command's input files, which it must not replace. folders : whether missing folders
    are created.
    """
    read = [Path(name) for name in given if name is not None and os.path.exists(name)]
    for path in paths:
        if path is None:
            continue
        _check_regular(path)
        if path.exists() and any(path.samefile(each) for each in read):
            raise InputError(f"{path}: is an input file and would be replaced; give another name or folder.")
        place = path.resolve().parent if path.is_symlink() else path.parent
        if not folders and not place.is_dir():
            raise InputError(f"{path}: cannot be written (no folder {place}); make the folder or give another.")
        _check_way(place)
        there = next(each for each in (place, *place.absolute().parents) if each.is_dir())
        try:
            with tempfile.TemporaryFile(dir=there):
                pass
        except OSError as error:
            raise _unwritable(path, error) from None


def check_new(files: Mapping[Path, Content], force: bool) -> None:
    """Raise ValueError if an editable file exists with different content. force : it may be replaced."""
    for path, content in files.items():
        if not force and path.is_file():
            if path.read_bytes() != (content.encode("utf-8") if isinstance(content, str) else content):
                raise InputError(f"{path}: exists and may have been edited; give another name, or --force.")


def _check_regular(path: Path) -> None:
    """Raise ValueError for a path that a rename would replace, such as a device, or fail on, such as a folder."""
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: cannot be written (not a regular file); give the name of a file.")


def _check_way(folder: Path) -> None:
    """Raise ValueError if a file is in the place of a folder."""
    file = next((each for each in (folder, *folder.parents) if each.exists() and not each.is_dir()), None)
    if file is not None:
        reason = "is a file, not a folder" if file == folder else f"cannot be made, as {file} is a file"
        raise InputError(f"{folder}: {reason}; give another folder.")


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(f"{path}: cannot be written ({error.strerror}); check the path and its directory.")
