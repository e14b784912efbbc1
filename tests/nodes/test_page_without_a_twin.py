"""A page beside a plant that no twin judges: nobody describes the plant, only its samples come."""

from __future__ import annotations

import pytest

from tests.support.ros import Inside, Listener
from twinmatch.showing.page.node import Dashboard
from twinmatch.signals import Sample

pytestmark = pytest.mark.ros


def test_set_points_are_sent_once_a_sample_has_shown_that_there_is_one_loop(
    listener: Listener,
) -> None:
    page = Inside(
        "dashboard", "-p", "port:=0", "-p", "control:=true", kinds=[Dashboard]
    )
    try:
        listener.wait_for_nodes()
        assert listener.node.count_publishers("plant/reference") == 0
        listener.send([Sample(0, 0, 30.0, 25.0, 10.0)])
        listener.spin_until(
            lambda: listener.node.count_publishers("plant/reference"),
            "who sends set-points",
        )
    finally:
        page.end()
