#!/usr/bin/env bash
# Compile requirements/*.txt: exact versions with hashes, no addresses. Arguments go to uv, --upgrade for instance.
set -euo pipefail
cd "$(dirname "$0")/.."

compile() {
    .venv/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header "$@" >/dev/null
}

compile "$@" --extra control --extra dask --output-file requirements/dev.txt pyproject.toml requirements/dev.in
compile --constraints requirements/dev.txt --output-file requirements/uv.txt requirements/uv.in
