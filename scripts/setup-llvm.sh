#!/bin/sh
# Sees to the two system libraries that Dr.Jit loads: libatomic, and a libLLVM that works. Keeps what works, else installs it
# where it may (apt as root or with passwordless sudo, or brew), else says in one line what to type. Without libLLVM the
# scalar variant serves, so that is no failure; without libatomic (a bare Debian or Ubuntu) nothing renders, which is one.
# Usage: setup-llvm.sh PYTHON, an interpreter that has the project installed.
set -u
python=${1:?usage: setup-llvm.sh PYTHON}

# Best known first (scenes/llvm.py). Not 16: it aborts on x86-64. Ubuntu 24.04 calls its 17 libllvm17t64.
llvm_packages='libllvm19 libllvm18 libllvm20 libllvm17 libllvm17t64 libllvm21 libllvm22'

loads() {
    "$python" -c 'import drjit' 2>/dev/null
}

# What decides is a trial in a subprocess, the same as at every start, not a version in a file's name.
works() {
    "$python" -m scenes.llvm 2>/dev/null
}

as_root() {
    if [ "$(id -u)" = 0 ]; then
        "$@"
    else
        sudo -n "$@"
    fi
}

has_apt() {
    command -v apt-get >/dev/null
}

apt_install() {
    echo "setup: installing $1 for Dr.Jit" >&2
    as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$1" >/dev/null
}

apt_install_llvm() {
    for package in $llvm_packages; do
        apt-cache show "$package" >/dev/null 2>&1 && apt_install "$package" && works && return 0
    done
    return 1
}

brew_install_llvm() {
    echo 'setup: installing llvm@19 for Dr.Jit' >&2
    brew install --quiet llvm@19 >/dev/null && works
}

works && exit 0

may_apt=no
if has_apt && as_root true 2>/dev/null; then
    may_apt=yes
    as_root apt-get update -qq >/dev/null || true # another source's failure need not matter
fi
if ! loads && ! { [ $may_apt = yes ] && apt_install libatomic1 && loads; }; then
    echo 'setup: Dr.Jit cannot be loaded; type: sudo apt-get update && sudo apt-get install libatomic1 libllvm19' >&2
    exit 1
fi
works && exit 0

command='install LLVM 19 with the package manager'
if has_apt; then
    [ $may_apt = yes ] && apt_install_llvm && exit 0
    command='sudo apt-get update && sudo apt-get install libllvm19'
elif command -v brew >/dev/null; then
    brew_install_llvm && exit 0
    command='brew install llvm@19'
fi
echo "setup: no libLLVM works, so rendering will be slow; to install one, type: $command"
