#!/usr/bin/env bash
# Print the Python that the environment is made with: $PYTHON if set, else the first that is new enough.
set -euo pipefail

version_of() { "$1" -c 'import sys; print("%d.%d.%d" % sys.version_info[:3])' 2>/dev/null; }
new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

if [ -n "${PYTHON:-}" ]; then candidates=("$PYTHON"); else candidates=(python3.13 python3.12 python3.11 python3); fi

found=""
for candidate in "${candidates[@]}"; do
    if version=$(version_of "$candidate"); then
        if new_enough "$candidate"; then
            command -v "$candidate"
            exit 0
        fi
        found=" ($candidate is $version)"
    elif [ -n "${PYTHON:-}" ]; then
        found=" (PYTHON=$PYTHON does not run)"
    fi
done
echo "error: Python 3.11 or newer is needed and was not found$found; install it or set PYTHON=/path/to/python3" >&2
exit 1
