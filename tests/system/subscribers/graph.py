"""Prints who publishes what: one line of JSON per topic, until SIGTERM; nothing of twinmatch."""

from __future__ import annotations

import json
import time

import rclpy

rclpy.init()
node = rclpy.create_node("graph")
print("ready", flush=True)
while rclpy.ok():
    rclpy.spin_once(node, timeout_sec=0.1)
    topics = {}
    for name, _ in node.get_topic_names_and_types():
        for end in node.get_publishers_info_by_topic(name):
            qos = end.qos_profile
            topics[name] = [end.topic_type, qos.reliability.name, qos.durability.name]
    print(json.dumps(topics), flush=True)
    time.sleep(0.3)
