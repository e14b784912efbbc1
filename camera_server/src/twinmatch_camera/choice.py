"""From the command line to a source. Each source's libraries are imported only when it is chosen."""

from __future__ import annotations

import argparse

from twinmatch_camera.errors import UsageError
from twinmatch_camera.sources.base import Source

__all__ = ["source"]


def source(arguments: argparse.Namespace) -> Source:
    """The source asked for, not yet opened.

    Raises:
        UsageError: an option cannot be followed.
        SourceError: a library that the source needs is not installed.
    """
    return _BUILDERS[arguments.source](arguments)


def _emulated(arguments: argparse.Namespace) -> Source:
    from twinmatch.emulation.lepton import LeptonError, LeptonSettings  # noqa: PLC0415
    from twinmatch_camera.sources.emulated import EmulatedSource  # noqa: PLC0415
    from twinmatch_camera.sources.followed import FollowedSource  # noqa: PLC0415

    try:
        settings = LeptonSettings(ambient=arguments.ambient, flat_field_period=arguments.flat_field_period)
        if arguments.feed == "-":
            return FollowedSource(settings=settings, seed=arguments.seed)
        return EmulatedSource(
            plate=arguments.plate, feed=arguments.feed, settings=settings, seed=arguments.seed
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
        raise UsageError(f"--spi {arguments.spi}: give BUS.DEVICE, such as 0.0 for /dev/spidev0.0")
    return LeptonSource(spi=(int(bus), int(device)), speed=arguments.speed, i2c=arguments.i2c)


def _v4l2(arguments: argparse.Namespace) -> Source:
    from twinmatch_camera.sources.v4l2 import V4l2Source  # noqa: PLC0415

    return V4l2Source(arguments.device, size=arguments.size, resolution=arguments.resolution)


_BUILDERS = {"emulated": _emulated, "recorded": _recorded, "lepton": _lepton, "v4l2": _v4l2}
