"""Compiles the benchmarks' programs in C when they are first wanted, into build/bench."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

HERE = Path(__file__).parent
FOLDER = HERE.parent / "build" / "bench"
COMPILER = ("cc", "gcc")
OPTIONS = ("-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror")
LIBMODBUS = ("-I/usr/include/modbus", "-lmodbus")  # where Debian's libmodbus-dev has it


class NotBuilt(Exception):
    """There is no compiler or no library; the text says what to install."""


def built(name: str, *libraries: str) -> Path:
    """Return the program made of bench/NAME.c, compiled anew if the source is newer; NotBuilt where that fails."""
    source, program = HERE / f"{name}.c", FOLDER / name
    if program.exists() and program.stat().st_mtime >= source.stat().st_mtime:
        return program
    compiler = next(filter(shutil.which, COMPILER), None)
    if compiler is None:
        raise NotBuilt(f"{source.name} wants a C compiler: apt-get install gcc libc6-dev")
    FOLDER.mkdir(parents=True, exist_ok=True)
    command = [compiler, *OPTIONS, "-o", str(program), str(source), *libraries]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NotBuilt(f"{source.name} was not compiled: {done.stderr.strip()}")
    return program
