"""A program of another DDS: Cyclone's Python binding reads samples; no ROS at all.

    python cyclone_reader.py

It prints `ready`, then one line of JSON per sample: `[stamp in ns, index, values…]`, until SIGTERM.

(No `from __future__ import annotations`: the binding cannot resolve a `str` that it turned into text.)
"""

import json
import os
import signal
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import float64, int32, sequence, uint32, uint64
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

LOOPBACK = """<CycloneDDS><Domain><General><Interfaces>
<NetworkInterface address="127.0.0.1" multicast="true"/>
</Interfaces></General></Domain></CycloneDDS>"""


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):  # type: ignore[call-arg]
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):  # type: ignore[call-arg]
    stamp: Time
    frame_id: str


@dataclass
class LoopSample(IdlStruct, typename="twinmatch_msgs::msg::dds_::LoopSample_"):  # type: ignore[call-arg]
    header: Header
    index: uint64
    reference: sequence[float64]
    output: sequence[float64]
    input: sequence[float64]
    disturbances: sequence[float64]


stop_requested = False


def request_stop(*_: object) -> None:
    global stop_requested  # noqa: PLW0603
    stop_requested = True


def stamp(header: Header) -> int:
    return header.stamp.sec * 1_000_000_000 + header.stamp.nanosec


def main() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, request_stop)
    number = int(os.environ["ROS_DOMAIN_ID"])
    domain = Domain(number, LOOPBACK)
    participant = DomainParticipant(number)
    reliable = Qos(
        Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll
    )
    reader = DataReader(
        participant, Topic(participant, "rt/plant/sample", LoopSample), qos=reliable
    )
    print("ready", flush=True)
    while not stop_requested:
        for message in reader.take(1000):
            if isinstance(message, LoopSample):
                # what else comes says that a writer has gone
                values = [
                    message.index,
                    *message.reference,
                    *message.output,
                    *message.input,
                ]
                print(json.dumps([stamp(message.header), *values]), flush=True)
        time.sleep(0.01)
    del reader, participant, domain


if __name__ == "__main__":
    main()
