#!/bin/sh
# Two machines with a cable between them, as far as the network can tell: run in namespaces of its own by
#   unshare --map-root-user --net --mount sh two_machines.sh PYTHON SESSION READER OUTPUT
# A player here, a reader over there, which gets 6 s once it has subscribed.
set -eu
python=$1 session=$2 reader=$3 output=$4

unshare --net --mount sh -c '
    mount -t tmpfs tmpfs /dev/shm
    while ! ip link show there >/dev/null 2>&1; do sleep 0.05; done
    ip link set lo up
    ip addr add 10.77.0.2/24 dev there
    ip link set there up
    ip route add 224.0.0.0/4 dev there
    exec timeout --preserve-status 8 "$@"
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
timeout --preserve-status 9 "$python" -m twinmatch.nodes.player --ros-args \
    -p "session:=$session" -p wait_for:=0 -p rate:=50.0 || true
wait "$there"
