#!/bin/sh
# The simulated Arduino needs a few Debian packages. Install them where that is possible without asking;
# otherwise say in one line what will be missing. Never fails: everything else works without them.
packages="gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev"
if command -v avr-gcc >/dev/null 2>&1 && [ -e /usr/include/simavr/sim_avr.h ]; then
    exit 0
fi
log=$(mktemp)
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "setup: installing the tools of the simulated Arduino ($packages)"
    { apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $packages; } \
        >"$log" 2>&1 && rm -f "$log" && exit 0
fi
rm -f "$log"
echo "setup: without $packages (Debian packages) the Arduino is a Python stand-in, and some tests are skipped"
