#!/usr/bin/env bash
# Make ready for the browser tests: Node.js 18, Chromium and playwright-core. With --install, Debian packages that are missing
# are installed, if this runs as root. Ends with 1, and says what to do, where something is missing.
set -uo pipefail
cd "$(dirname "$0")"

has_node() {
    command -v npm >/dev/null && node -e 'process.exit(Number(process.versions.node.split(".")[0]) >= 18 ? 0 : 1)' 2>/dev/null
}
has_chromium() {
    [ -n "${CHROMIUM:-}" ] && { command -v "$CHROMIUM" >/dev/null; return; }
    for name in chromium chromium-browser google-chrome chrome; do command -v "$name" >/dev/null && return; done
    return 1
}

if [ "${1:-}" = --install ] && [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    missing=()
    command -v node >/dev/null || missing+=(nodejs npm)
    has_chromium || missing+=(chromium)
    if [ ${#missing[@]} -gt 0 ]; then
        { apt-get update -qq; DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends "${missing[@]}"; } \
            >/dev/null 2>&1 || echo "apt-get could not install ${missing[*]}" >&2
    fi
fi
has_node || { echo 'Node.js 18 or later with npm is needed and was not found; on Debian: apt install nodejs npm' >&2; exit 1; }
has_chromium || {
    echo 'Chromium is needed and was not found; on Debian: apt install chromium, elsewhere: CHROMIUM=/path/to/chromium' >&2
    exit 1
}
if ! cmp -s package-lock.json node_modules/.terrex-lock; then
    npm ci --silent --no-progress >&2 || {
        echo 'npm could not install playwright-core; check the network, or the registry that npm is set to' >&2
        exit 1
    }
    cp package-lock.json node_modules/.terrex-lock
fi
