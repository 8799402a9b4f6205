# Sourced by scripts/demo and scripts/test: system libraries, a virtual environment and the project in it.
# VENV: where the environment goes (default: .venv in the project).
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
VENV="${VENV:-$PWD/.venv}"

# open3d (fusion, the demo's renderer) is linked against these; python3-venv makes the environment
declare -A libraries=(
  [libusb-1.0.so.0]=libusb-1.0-0 [libGL.so.1]=libgl1 [libEGL.so.1]=libegl1 [libX11.so.6]=libx11-6 [libudev.so.1]=libudev1
  [libgomp.so.1]=libgomp1)
missing=()
for library in "${!libraries[@]}"; do
  python3 -c "import ctypes; ctypes.CDLL('$library')" 2>/dev/null || missing+=("${libraries[$library]}")
done
python3 -c 'import ensurepip, venv' 2>/dev/null || missing+=(python3-venv)
if [ ${#missing[@]} -gt 0 ]; then
  install="apt-get update && apt-get install -y --no-install-recommends ${missing[*]}"
  if ! command -v apt-get >/dev/null; then
    echo "These libraries are missing, install them with your system's package manager: ${missing[*]}" >&2
    exit 1
  elif [ "$(id -u)" -ne 0 ]; then
    echo "Libraries that open3d needs are missing.  Run this once, then try again:" >&2
    echo "  sudo sh -c '$install'" >&2
    exit 1
  fi
  echo "Installing system libraries that open3d needs: ${missing[*]}"
  DEBIAN_FRONTEND=noninteractive sh -c "$install" >/dev/null
fi

python3 - <<'CHECK'
import sys
if not (3, 11) <= sys.version_info[:2] <= (3, 13):
    sys.exit(f"wbflow needs Python 3.11 to 3.13; python3 is {sys.version.split()[0]}")
CHECK

install_project() { # install_project EXTRAS
  [ -x "$VENV/bin/python" ] || python3 -m venv "$VENV"
  echo "Installing wbflow into $VENV"
  "$VENV/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile --editable ".${1:-}"
  # Every process of every run would compile the project anew where caches of it are not written: an editable install leaves it as it
  # is.  What it needs is compiled with it, on all processors: pip would do so on one, and with much that is never imported.
  local libraries unused='/(tests?|plotly|fontTools|moto|pip|setuptools|selenium|lexers|mypyc?|transformers)/'
  libraries="$("$VENV/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"
  "$VENV/bin/python" -m compileall -q wbflow stages tests
  "$VENV/bin/python" -m compileall -q -j 0 -x "$unused" "$libraries" >/dev/null || true # some hold what is no Python
}

install_browser() { # for the tests of the report's page alone, which are skipped without
  if command -v chromium >/dev/null && command -v chromedriver >/dev/null; then return; fi
  if command -v apt-get >/dev/null && [ "$(id -u)" -eq 0 ]; then
    echo "Installing chromium for the tests of the report's page"
    DEBIAN_FRONTEND=noninteractive sh -c 'apt-get update && apt-get install -y --no-install-recommends chromium chromium-driver' \
      >/dev/null || echo "chromium could not be installed: the tests of the report's page are skipped" >&2
  fi
}
