"""What a measurement on a GPU needs, and whether each kernel's self-test agrees: python benchmarks/gpu_check.py.

Missing packages are named first. Then every case of the self-test stands with the share of its values that differ
from the processor's, or with the error that it ends with. The exit code is 1 where a package is missing or a case
does not agree.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module

MODULES = "gpu", "cuda.core", "cuda.bindings.driver", "pytest", "xdist", "hypothesis"
"""What the steps of `gpu.sh` import, with all that they need."""


def find_missing() -> list[str]:
    """Return the modules that are not installed; of each of the `MODULES` the first that it lacks."""
    missing: list[str] = []
    for name in MODULES:
        try:
            module = import_module(name)
        except ModuleNotFoundError as error:
            missing.append(str(error.name))
        except ImportError as error:  # such as of a wheel of another state than this checkout
            missing.append(f"{name} as it should be ({error})")
        else:
            print(f"{name}: {getattr(module, '__version__', '')} {getattr(module, '__file__', '')}")
    return missing


def compare_cases(device: str) -> int:
    """Print how far each case of the self-test is from the processor's result; return how many do not agree."""
    from beltscape.kernels import load, self_test  # may be missing

    start = time.perf_counter()
    kernels, native = load(device), load("native")
    print(f"kernels compiled and loaded in {time.perf_counter() - start:.1f} s")
    wrong = 0
    for name, run in self_test.CASES.items():
        try:
            share = self_test.compare_results(run(kernels), run(native))
        except Exception as error:  # of whatever kind: the other cases are run all the same
            print(f"{name}: {type(error).__name__}: {error}")
            wrong += 1
            continue
        print(f"{name}: {share:.4%} of the values differ")
        wrong += share > self_test.MOST_DIFFERENT
    if kernels.failure:
        print(f"the GPU failed: {kernels.failure}")
    return wrong + (kernels.failure is not None)


def main() -> int:
    """Check packages and kernels."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--device", choices=("cuda", "emulated", "none"), default="cuda")
    device = parser.parse_args().device
    missing = find_missing()
    if missing:
        print(f"missing: {', '.join(missing)}; put their wheels, of this state, into WHEELS", file=sys.stderr)
        return 1
    if device == "none":
        return 0
    from beltscape.core.errors import KernelError

    try:
        wrong = compare_cases(device)
    except KernelError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"{wrong} cases do not agree")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
