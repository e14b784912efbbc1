"""What tests mount."""

from __future__ import annotations

from pathlib import Path

from tests.support.disks import small_disk


def test_what_a_test_mounts_is_seen_by_no_other_process(tmp_path: Path) -> None:
    """So it vanishes with the run of the tests, however that ends."""
    with small_disk(tmp_path / "disk", 100) as disk:
        assert str(disk) in Path("/proc/self/mounts").read_text()
        assert str(disk) not in Path("/proc/1/mounts").read_text()
