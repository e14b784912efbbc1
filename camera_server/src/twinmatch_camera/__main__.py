"""Command line of the camera program."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from twinmatch_camera.errors import CameraError, UsageError

if TYPE_CHECKING:
    from twinmatch_camera.sources.base import Source

_log = logging.getLogger("twinmatch_camera")

DEFAULT_HOST = "127.0.0.1"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code (see `twinmatch_camera.errors`)."""
    arguments = _parser().parse_args(argv)
    logging.basicConfig(stream=sys.stderr, format="twinmatch-camera: %(message)s")
    _log.setLevel(logging.INFO)
    try:
        _run(arguments)
    except CameraError as error:
        _log.error("%s", error)
        return error.exit_code
    except KeyboardInterrupt:
        return 0
    return 0


def _run(arguments: argparse.Namespace) -> None:
    try:
        from twinmatch.links.thermal_frame import DEFAULT_PORT  # noqa: PLC0415
    except ImportError as error:
        msg = f"{error}; install the frame codec with `pip install --no-deps twinmatch`"
        raise UsageError(msg) from error
    from twinmatch_camera.broadcast import Broadcast  # noqa: PLC0415
    from twinmatch_camera.program import run  # noqa: PLC0415

    chosen = arguments.make(arguments)
    host, port = _address(arguments.listen, DEFAULT_PORT)
    run(
        chosen,
        Broadcast(
            host, port, max_clients=arguments.max_clients, patience=arguments.patience
        ),
    )


def _address(text: str, default_port: int) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]"):
        host = text
        port = str(default_port)
    host = host.strip("[]")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"--listen {text}: give HOST or HOST:PORT, such as {DEFAULT_HOST}:{default_port}"
        )
    return host, int(port)


# Each source's libraries are imported only when it is chosen.


def _emulated(arguments: argparse.Namespace) -> Source:
    from twinmatch_camera.emulation import LeptonError, LeptonSettings  # noqa: PLC0415
    from twinmatch_camera.sources.emulated import EmulatedSource  # noqa: PLC0415
    from twinmatch_camera.sources.followed import FollowedSource  # noqa: PLC0415

    try:
        settings = LeptonSettings(
            ambient=arguments.ambient, flat_field_period=arguments.flat_field_period
        )
        if arguments.feed == "-":
            return FollowedSource(settings=settings, seed=arguments.seed)
        return EmulatedSource(
            plate=arguments.plate,
            feed=arguments.feed,
            settings=settings,
            seed=arguments.seed,
        )
    except LeptonError as error:
        raise UsageError(str(error)) from error


def _recorded(arguments: argparse.Namespace) -> Source:
    from twinmatch_camera.sources.recorded import RecordedSource  # noqa: PLC0415

    return RecordedSource(arguments.file, loop=arguments.loop)


def _lepton(arguments: argparse.Namespace) -> Source:
    from twinmatch_camera.sources.lepton import LeptonSource  # noqa: PLC0415

    bus, dot, device = arguments.spi.partition(".")
    if not (dot and bus.isdecimal() and device.isdecimal()):
        raise UsageError(
            f"--spi {arguments.spi}: give BUS.DEVICE, such as 0.0 for /dev/spidev0.0"
        )
    return LeptonSource(
        spi=(int(bus), int(device)), speed=arguments.speed, i2c=arguments.i2c
    )


def _v4l2(arguments: argparse.Namespace) -> Source:
    from twinmatch_camera.sources.v4l2 import V4l2Source  # noqa: PLC0415

    return V4l2Source(
        arguments.device, size=arguments.size, resolution=arguments.resolution
    )


def _parser() -> argparse.ArgumentParser:
    common = argparse.ArgumentParser(add_help=False)
    common.add_argument(
        "--listen",
        default=DEFAULT_HOST,
        metavar="HOST[:PORT]",
        help="address to serve on (default: this computer only; port 5580, 0 for any free one)",
    )
    common.add_argument(
        "--max-clients", type=_at_least_one, default=8, metavar="N", help="default: 8"
    )
    common.add_argument(
        "--patience",
        type=_positive,
        default=1.0,
        metavar="S",
        help="seconds a client may take for a frame (1)",
    )
    parser = argparse.ArgumentParser(
        prog="twinmatch-camera", description="Serve a thermal camera over TCP."
    )
    sources = parser.add_subparsers(dest="source", required=True, metavar="SOURCE")

    emulated = sources.add_parser(
        "emulated", parents=[common], help="an emulated Lepton over a simulated plate"
    )
    plate = emulated.add_mutually_exclusive_group(required=True)
    plate.add_argument(
        "--plate",
        type=float,
        metavar="CELSIUS",
        help="constant temperature of the plate",
    )
    plate.add_argument(
        "--feed",
        metavar="PATH",
        help="socket to make, to which a simulation sends temperatures; -: it leads us on standard input",
    )
    emulated.add_argument(
        "--seed", type=int, default=0, help="of the noise (default: 0)"
    )
    emulated.add_argument(
        "--ambient", type=float, default=23.0, metavar="CELSIUS", help="default: 23"
    )
    emulated.add_argument(
        "--flat-field-period",
        type=_positive,
        default=180.0,
        metavar="S",
        help="seconds (default: 180)",
    )

    emulated.set_defaults(make=_emulated)

    recorded = sources.add_parser(
        "recorded", parents=[common], help="frames from a file"
    )
    recorded.add_argument(
        "file", help="CBOR sequence of frames, as received from this program"
    )
    recorded.add_argument("--loop", action="store_true", help="begin again at the end")
    recorded.set_defaults(make=_recorded)

    lepton = sources.add_parser(
        "lepton", parents=[common], help="a FLIR Lepton 2.5 over SPI and I2C"
    )
    lepton.add_argument(
        "--spi",
        default="0.0",
        metavar="BUS.DEVICE",
        help="default: 0.0, /dev/spidev0.0",
    )
    lepton.add_argument(
        "--speed",
        type=int,
        default=16_000_000,
        metavar="HZ",
        help="SPI clock (16000000)",
    )
    lepton.add_argument(
        "--i2c", type=int, default=1, metavar="BUS", help="default: 1, /dev/i2c-1"
    )
    lepton.set_defaults(make=_lepton)

    v4l2 = sources.add_parser(
        "v4l2", parents=[common], help="a video device that delivers Y16"
    )
    v4l2.add_argument(
        "device", nargs="?", default="/dev/video0", help="default: /dev/video0"
    )
    v4l2.add_argument(
        "--size",
        type=_size,
        default=(80, 60),
        metavar="WxH",
        help="80x60, or 80x63 with telemetry (80x60)",
    )
    v4l2.add_argument(
        "--resolution",
        type=_positive,
        default=0.01,
        metavar="K",
        help="kelvin per count (0.01)",
    )
    v4l2.set_defaults(make=_v4l2)
    return parser


def _at_least_one(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is below 1")
    return value


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    return int(width), int(height)


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not positive")
    return value


if __name__ == "__main__":
    sys.exit(main())
