"""Run a command on every Python that the package supports and that is installed, and once with the lowest versions.

`make matrix` calls it with the arguments that `make test` gives to Python. Each interpreter gets an environment of
its own below `.matrix`, which is built again when pyproject.toml changes. The newest one also runs it with products of
matrices that differ in their last digits: with another kernel of OpenBLAS, and with two threads of it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from constraints import PYPROJECT, constraints

TOP = PYPROJECT.parent
ENVIRONMENTS = TOP / ".matrix"
OLDEST = (3, 11)
KERNELS = Path(__file__).with_name("kernels.py")
EXECUTABLE = re.compile(r"python3\.\d+")
PRINT_VERSION = "import sys; print(*sys.version_info[:2])"


def folders() -> Iterator[Path]:
    """Where interpreters may be: the folders of PATH, then every version that pyenv holds, active or not."""
    yield from (Path(folder) for folder in os.environ.get("PATH", "").split(os.pathsep) if folder)
    if shutil.which("pyenv"):
        root = subprocess.run(["pyenv", "root"], capture_output=True, text=True, check=True).stdout.strip()
        yield from sorted(Path(root).glob("versions/*/bin"))


def version(interpreter: Path) -> tuple[int, int] | None:
    """What the interpreter calls itself; None where it does not run, as a pyenv shim of an inactive version."""
    answer = subprocess.run([interpreter, "-c", PRINT_VERSION], capture_output=True, text=True, check=False)
    if answer.returncode != 0:
        return None
    major, minor = answer.stdout.split()
    return int(major), int(minor)


def interpreters() -> dict[tuple[int, int], Path]:
    """The first working interpreter of each supported version, oldest version first."""
    found: dict[tuple[int, int], Path] = {}
    for folder in folders():
        for path in folder.glob("python3.*"):
            if EXECUTABLE.fullmatch(path.name) and os.access(path, os.X_OK):
                number = version(path)
                if number is not None and number >= OLDEST:
                    found.setdefault(number, path)
    return dict(sorted(found.items()))


def build(name: str, interpreter: Path, constrained: str) -> Path:
    """The Python of an environment with the package and what its tests need; `constrained` are lines for pip."""
    folder = ENVIRONMENTS / name
    python, stamp = folder / "bin" / "python", folder / "built-from"
    recipe = PYPROJECT.read_text(encoding="utf-8") + constrained
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == recipe:
        return python
    subprocess.run([interpreter, "-m", "venv", "--clear", folder], check=True)
    limits = folder / "constraints.txt"
    limits.write_text(constrained, encoding="utf-8")
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, "--constraint", limits, "--editable", f"{TOP}[test]"], check=True)
    stamp.write_text(recipe, encoding="utf-8")
    return python


def main(arguments: list[str]) -> int:
    """Build each environment, run its Python with `arguments`, and say how each did."""
    found = interpreters()
    if not found:
        print(f"no Python from {OLDEST[0]}.{OLDEST[1]} on PATH or in pyenv", file=sys.stderr)
        return 1
    names = {version: f"python{version[0]}.{version[1]}" for version in found}
    oldest, newest = min(found), max(found)
    rows: list[tuple[str, str, Path, str, list[str]]] = [
        *((name, name, found[version], "", []) for version, name in names.items()),
        (f"{names[oldest]}-lowest", f"{names[oldest]}-lowest", found[oldest], constraints(), []),
        (f"{names[newest]}-kernel", names[newest], found[newest], "", [sys.executable, str(KERNELS)]),
        (f"{names[newest]}-threads", names[newest], found[newest], "", ["env", "OPENBLAS_NUM_THREADS=2"]),
    ]
    results = []
    for name, folder, interpreter, constrained, before in rows:
        print(f"\n=== {name}", flush=True)
        begin = time.monotonic()
        try:
            python = build(folder, interpreter, constrained)
            code = subprocess.run([*before, python, *arguments], cwd=TOP).returncode
            said = "passed" if code == 0 else f"failed ({code})"
        except subprocess.CalledProcessError as error:
            said = f"not built ({error.returncode})"
        results.append((name, said, time.monotonic() - begin))
    print()
    for name, said, seconds in results:
        print(f"{name:<20} {said:<14} {seconds:5.0f} s")
    return int(any(said != "passed" for _, said, _ in results))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
