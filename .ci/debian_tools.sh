#!/bin/sh
# debian_tools.sh board|broker|browser|workspace: some tests need Debian packages. Install them where that is possible
# without asking; otherwise say in one line what will be missing. Never fails: everything else works without them.
have() { for name in "$@"; do command -v "$name" >/dev/null 2>&1 || [ -e "$name" ] || return 1; done; }
case $1 in
board)
    packages="gcc-avr avr-libc arduino-core-avr libsimavr-dev libelf-dev"
    use="the tools of the simulated Arduino" missing="the Arduino is a Python stand-in, and some tests are skipped"
    have avr-gcc /usr/include/simavr/sim_avr.h && exit 0
    ;;
broker)
    packages="mosquitto"
    use="a second MQTT broker" missing="MQTT is tried with one broker only"
    PATH=$PATH:/usr/sbin have mosquitto && exit 0
    ;;
browser)
    packages="chromium chromium-driver"
    use="the browser the live page is tested in" missing="the tests of the live page in a browser are skipped"
    have chromium chromedriver && exit 0
    ;;
workspace)
    packages="colcon python3-colcon-ros python3-colcon-package-information ament-cmake"
    use="what builds a ROS workspace" missing="the tests that build a ROS workspace are skipped"
    python=/usr/lib/python3/dist-packages
    have colcon $python/colcon_ros $python/colcon_package_information /usr/share/ament_cmake/cmake && exit 0
    ;;
*)
    echo "debian_tools.sh: $1: board, broker, browser or workspace" >&2
    exit 2
    ;;
esac
log=$(mktemp)
trap 'rm -f "$log"' EXIT
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
    echo "setup: installing $use ($packages)"
    # In the runlevel of a single user no service is started: a broker on the usual port might be in the way.
    { apt-get update && RUNLEVEL=1 DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $packages; } \
        >"$log" 2>&1 && exit 0
fi
echo "setup: without $packages (Debian packages) $missing"
