"""Side-by-side benchmarks: what a user would pick instead, on the same data, in the same process.

Run with `make bench` or `python -m benches --help`. Everything uses one thread, so that a ratio compares
algorithms and not core counts; the limits must stand before the first BLAS is loaded, hence here.
"""

import os

for _library in ("OPENBLAS", "MKL", "OMP", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR", "RAYON"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
