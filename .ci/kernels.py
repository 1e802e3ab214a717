"""Run a command with a kernel of OpenBLAS that this processor does not take by itself.

Products of matrices differ in their last digits from one kernel to another, and no answer may hang on these. `make kernels`
calls this with the numerical tests, `make matrix` runs all tests so; on one processor they would meet one kernel only.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

SET_KERNEL = "OPENBLAS_CORETYPE"
OTHERS = ("Haswell", "Sandybridge", "ARMV8", "NEOVERSEN1")  # of x86 without AVX-512 and AVX2; of ARM
PRINT_KERNELS = """
import scipy.linalg, threadpoolctl
print(*{library.get("architecture") for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"})
"""


def kernels(python: str | Path, environment: Mapping[str, str]) -> set[str]:
    """The kernels that the BLAS libraries of NumPy and SciPy take in an environment."""
    command = [python, "-c", PRINT_KERNELS]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    return set(said.split())


def with_other_kernel(python: str | Path) -> dict[str, str] | None:
    """The environment with another kernel than that taken in it; None where there is none, as of another BLAS."""
    own = kernels(python, os.environ)
    if "Zen" in own:
        own.add("Haswell")  # whose code that is
    for kernel in OTHERS:
        environment = {**os.environ, SET_KERNEL: kernel}
        if kernel not in own and kernels(python, environment) == {kernel}:
            return environment
    return None


def main(command: list[str]) -> int:
    """Run `command`, whose first word is a Python, with another kernel, and say with which."""
    environment = with_other_kernel(command[0])
    if environment is None:
        print(
            "OpenBLAS has no other kernel for this processor, or is not the BLAS: nothing is tested with another"
        )
        return 0
    print(f"=== {SET_KERNEL}={environment[SET_KERNEL]}", flush=True)
    return subprocess.run(command, env=environment).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
