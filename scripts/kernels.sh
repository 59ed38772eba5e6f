#!/usr/bin/env bash
# Build the Rust kernels and install the package into .venv, so that edits in src/ take effect at once.
set -euo pipefail
cd "$(dirname "$0")/.."
export VIRTUAL_ENV="$PWD/.venv" UV_NO_PROGRESS=1
unset CONDA_PREFIX

echo "Building the Rust kernels"
.venv/bin/maturin develop --release --locked --uv --quiet
