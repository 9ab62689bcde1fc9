#!/bin/sh
# Makes the virtual environment .venv with the project and its development tools in it.
# PYTHON names the interpreter; without it the first Python 3.11 or newer on the PATH is taken.
set -eu
cd "$(dirname "$0")/.."

suits() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1
}

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    else
        sudo -n "$@"
    fi
}

# Debian and Ubuntu ship venv apart from Python, in a package named after the version.
install_venv_package() {
    command -v apt-get >/dev/null && as_root true 2>/dev/null || return 1
    echo "setup: installing $1" >&2
    as_root apt-get update -qq >/dev/null || true # another source's failure need not matter
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$1" >/dev/null
}

python=
for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.11 python3.14}; do
    if suits "$candidate"; then
        python=$candidate
        break
    fi
done
if [ -z "$python" ]; then
    echo "setup: no Python 3.11 or newer found; install one (sudo apt-get install python3 python3-venv) or set PYTHON to it" >&2
    exit 1
fi

# One whose interpreter is gone (a moved checkout, an upgraded system) is made anew.
if ! suits .venv/bin/python || ! .venv/bin/python -m pip --version >/dev/null 2>&1; then
    if ! "$python" -c 'import ensurepip, venv' >/dev/null 2>&1; then
        package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
        if ! install_venv_package "$package"; then
            # with what setup-llvm.sh would ask for next, so that one line is typed once
            echo "setup: Python's venv is missing; type:" \
                "sudo apt-get update && sudo apt-get install $package libatomic1 libllvm19" >&2
            exit 1
        fi
    fi
    "$python" -m venv --clear .venv
fi

echo "setup: installing the Python packages (some minutes the first time)"
.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
