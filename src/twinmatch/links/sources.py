"""Sources by the scheme of a URL: `mqtt://…` is read by the module `mqtt_source` of this package."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module
from typing import Protocol, cast

from twinmatch import links
from twinmatch.sampling.channels import Channel, SamplingError
from twinmatch.sampling.listener import Receive, Source

_SUFFIX = "_source"


class WireProtocol(Protocol):
    """What a module that reads a protocol has."""

    def parse_place(self, text: str) -> Channel:
        """A place as it is written in a map.

        Raises:
            SamplingError: it is not one.
        """

    def open_source(
        self, url: str, period: float, channels: list[Channel], receive: Receive
    ) -> Source:
        """Connect, and read these channels; `period` (s) is that of the samples.

        Raises:
            TwinmatchError: the URL cannot be used, or what it names cannot be reached.
        """

    def listing(self, url: str, where: str) -> Iterator[str]:
        """The places there are, with what they say now, a line each; `where` says which part is listed.

        Raises:
            TwinmatchError: as for `open_source`.
        """


def protocol_of(url: str) -> WireProtocol:
    """The module for a URL; of a secure one, such as `mqtts://`, that of its plain one.

    Raises:
        SamplingError: there is none, or a package that it needs is not installed.
    """
    scheme, colon, _ = url.partition("://")
    modules = [module.name for module in pkgutil.iter_modules(links.__path__)]
    source_modules = sorted(name for name in modules if name.endswith(_SUFFIX))
    modules_by_scheme = {name.removesuffix(_SUFFIX): name for name in source_modules}
    plain_schemes = (scheme, scheme.removesuffix("s"), scheme.partition("+")[0])
    scheme_name = next(
        (name for name in plain_schemes if name in modules_by_scheme), ""
    )
    if not (colon and scheme_name):
        forms = " or ".join(f"{name}://…" for name in modules_by_scheme)
        raise SamplingError(f"source: {url!r} has no known beginning; write {forms}")
    try:
        return cast(
            "WireProtocol",
            import_module(f"{links.__name__}.{modules_by_scheme[scheme_name]}"),
        )
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        raise SamplingError(
            f"source: {scheme_name}:// needs {package}, which is not installed; pip install "
            f"'twinmatch[{scheme_name}]'"
        ) from None
