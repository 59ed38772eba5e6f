#!/usr/bin/env bash
# Check what the build needs from the system: a Rust toolchain, a C linker, and venv for the Python given as $1.
# On Debian and its kin the linker and venv are installed if we may; anything else is one line and a failure.
set -euo pipefail
python=$1

fail() { echo "error: $1" >&2; exit 1; }

as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo -n "$@"; fi
}

may_install() {
    command -v apt-get >/dev/null || return 1
    [ "$(id -u)" = 0 ] || sudo -n true 2>/dev/null
}

apt_install() {
    echo "Installing $* with apt-get"
    { as_root apt-get update -q && as_root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends "$@"; } \
        >/dev/null 2>&1
}

has_linker() { command -v cc >/dev/null; }
has_venv() { "$python" -c 'import ensurepip, venv' 2>/dev/null; }

command -v cargo >/dev/null && cargo --version >/dev/null 2>&1 \
    || fail "a Rust toolchain (cargo, rustc 1.88 or newer) is needed and was not found; see https://rustup.rs"

rust=$(rustc --version | cut -d' ' -f2)
minor=${rust#1.}
minor=${minor%%.*}
[ "$minor" -ge 88 ] || fail "rustc 1.88 or newer is needed, found $rust; run rustup update"

if ! has_linker; then
    may_install && apt_install gcc libc6-dev || true
    has_linker || fail "a C linker (cc) is needed and was not found; install gcc and the C library's headers"
fi

if ! has_venv; then
    short=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    may_install && { apt_install "python$short-venv" || apt_install python3-venv; } || true
    has_venv || fail "$python lacks the venv module; install it (Debian: python$short-venv) or set PYTHON=/path/to/python3"
fi
