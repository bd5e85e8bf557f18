# shellcheck shell=bash
# Sourced by the other scripts: a virtual environment with what a role needs, made once.
#
#   prepare EXTRAS     e.g. prepare drone,edge   ->   $ROOT/.venv
#   prepare_gl         OpenGL without a screen, for the simulator
#   help_of "$@"       for --help or -h: prints the script's own first comment, and ends it
#
# PYTHON           the interpreter to use (default: the first of python3.11 .. python3 that is new enough)
# TORCH_INDEX_URL  a package index with CPU builds of torch; without it the default index decides, whose
#                  Linux builds bring gigabytes of CUDA along
set -euo pipefail
ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
VENV=$ROOT/.venv
BIN=$VENV/bin

say() { printf '%s\n' "$*" >&2; }
die() { say "error: $*"; exit 2; }

help_of() {
  case "${1:-}" in
    -h | --help) ;;
    *) return 0 ;;
  esac
  sed -n '2,/^[^#]/{s/^# \{0,1\}//p;}' "$0"
  exit 0
}

find_python() {
  local candidate
  for candidate in "${PYTHON:-}" python3.11 python3.12 python3.13 python3; do
    if [ -n "$candidate" ] && command -v "$candidate" >/dev/null &&
      "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
      command -v "$candidate"
      return
    fi
  done
  die "no Python 3.11 or newer found. On Debian: apt-get install python3 python3-venv (or set PYTHON=...)"
}

make_venv() {
  local python=$1
  if "$python" -m venv "$VENV" >/dev/null 2>&1; then return; fi
  rm -rf "$VENV"
  # Debian splits venv off: install it where we may, say so where we may not.
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    say "installing python3-venv ..."
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv; } >/dev/null ||
      die "could not install python3-venv"
    "$python" -m venv "$VENV" || die "$python cannot make a virtual environment"
  else
    die "$python cannot make a virtual environment. On Debian: sudo apt-get install python3-venv"
  fi
}

prepare() {
  local extras=$1 python stamp
  python=$(find_python)
  stamp=$VENV/.prepared-$extras-$({ cat "$ROOT/pyproject.toml"; "$python" -V; } | cksum | tr -d ' ')
  [ -e "$stamp" ] && return
  # Two scripts at once would run pip in one environment. The lock ends with the file descriptor;
  # where there is no flock (macOS) it goes without.
  exec 9<"$ROOT/scripts/setup.sh"
  if command -v flock >/dev/null && ! flock -n 9; then
    say "waiting for another script that sets up .venv ..."
    flock 9
  fi
  set_up "$extras" "$python" "$stamp"
  exec 9<&-
}

# The simulator draws without a screen: Mesa's EGL, or OSMesa. Installed where we may; where not, the
# simulator itself says what is missing.
prepare_gl() {
  "$BIN/python" -c 'import ctypes.util, sys; sys.exit(not any(map(ctypes.util.find_library, ("EGL", "OSMesa"))))' && return
  if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    say "installing libegl1 and libegl-mesa0, to draw without a screen ..."
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq libegl1 libegl-mesa0; } >/dev/null ||
      say "could not install them"
  fi
}

set_up() {
  local extras=$1 python=$2 stamp=$3
  [ -e "$stamp" ] && return # another script did it meanwhile
  say "setting up .venv for $extras (once) ..."
  [ -x "$BIN/python" ] || make_venv "$python"
  # torch first and by itself, so that an index given for it serves nothing else
  "$BIN/python" -m pip install -q --disable-pip-version-check ${TORCH_INDEX_URL:+--index-url "$TORCH_INDEX_URL"} \
    "torch==2.13.0" || die "could not install torch 2.13.0"
  "$BIN/python" -m pip install -q --disable-pip-version-check -e "$ROOT[$extras]" ||
    die "could not install the project with its packages"
  touch "$stamp"
}
