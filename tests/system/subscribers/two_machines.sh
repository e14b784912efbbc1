#!/bin/sh
# Two machines with a cable between them, as far as the network can tell: run in namespaces of its own by
#   unshare --map-root-user --net --mount sh two_machines.sh PYTHON SESSION READER OUTPUT SECONDS
# A player here, a reader over there. Once the reader has subscribed it is given until it has received something,
# at most SECONDS.
set -eu
python=$1 session=$2 reader=$3 output=$4 seconds=$5

unshare --net --mount sh -c '
    mount -t tmpfs tmpfs /dev/shm
    while ! ip link show there >/dev/null 2>&1; do sleep 0.05; done
    ip link set lo up
    ip addr add 10.77.0.2/24 dev there
    ip link set there up
    ip route add 224.0.0.0/4 dev there
    exec "$@"
' over_there "$python" "$reader" twinmatch_msgs/LoopSample plant/sample >"$output" 2>&1 &
there=$!
while [ "$(readlink /proc/$there/ns/net)" = "$(readlink /proc/self/ns/net)" ]; do sleep 0.05; done

mount -t tmpfs tmpfs /dev/shm
ip link set lo up
ip link add here type veth peer name there
ip link set there netns "$there"
ip addr add 10.77.0.1/24 dev here
ip link set here up
ip route add 224.0.0.0/4 dev here
"$python" -m twinmatch.nodes player --ros-args -p "session:=$session" -p wait_for:=0 -p rate:=5.0 &
here=$!
trap 'kill "$here" "$there" 2>/dev/null || true' EXIT
while ! grep -q ready "$output" || [ "$(wc -l </proc/net/udp)" -lt 2 ]; do # both have opened their sockets
    kill -0 "$there"
    kill -0 "$here"
    sleep 0.05
done
left=$((10 * seconds))
while [ $left -gt 0 ] && ! grep -q index "$output"; do
    left=$((left - 1))
    sleep 0.1
done
kill "$here" "$there"
wait "$here" || true
wait "$there"
