#!/usr/bin/env bash
# Make .venv and install exactly what requirements/dev.txt says.
set -euo pipefail
cd "$(dirname "$0")/.."
export PIP_DISABLE_PIP_VERSION_CHECK=1 UV_PYTHON_DOWNLOADS=never UV_NO_PROGRESS=1
if [ -n "${PIP_INDEX_URL:-}" ]; then export UV_DEFAULT_INDEX="${UV_DEFAULT_INDEX:-$PIP_INDEX_URL}"; fi

python=$(scripts/find-python.sh)
scripts/prerequisites.sh "$python"

usable() { .venv/bin/python -m pip --version >/dev/null 2>&1; }
if ! usable; then
    echo "Making .venv with $("$python" --version) ($python)"
    rm -rf .venv
    "$python" -m venv .venv
fi
.venv/bin/python -m pip install --quiet --require-hashes -r requirements/uv.txt
echo "Installing the Python packages of requirements/dev.txt"
.venv/bin/uv pip sync --quiet --require-hashes --python .venv/bin/python requirements/dev.txt
