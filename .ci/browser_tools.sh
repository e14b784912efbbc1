#!/bin/sh
# The live page is tested in a real browser. Install one where that is possible without asking; otherwise say
# in one line what will be missing. Never fails: everything else works without it.
packages="chromium chromium-driver"
if command -v chromium >/dev/null 2>&1 && command -v chromedriver >/dev/null 2>&1; then
    exit 0
fi
log=$(mktemp)
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "setup: installing the browser the live page is tested in ($packages)"
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $packages; } \
        >"$log" 2>&1 && rm -f "$log" && exit 0
fi
rm -f "$log"
echo "setup: without $packages (Debian packages) the tests of the live page in a browser are skipped"
