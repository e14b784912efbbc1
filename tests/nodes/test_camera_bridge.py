"""The camera bridge on the stream of the real camera program with an emulated Lepton."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, Temperature
from std_msgs.msg import Float64, Header
from twinmatch_camera.emulation import EmulatedLepton, LeptonSettings

from tests.support.camera import CameraProgram
from tests.support.processes import Processes, Start
from twinmatch.links.thermal_client import RegionError
from twinmatch.links.thermal_frame import Exposure, FlatField, FrameFlags, encode_frame
from twinmatch.nodes.camera_bridge import (
    WallToRos,
    celsius_image,
    centikelvin,
    raw_image,
)
from twinmatch.nodes.network import sockets_elsewhere

pytestmark = pytest.mark.ros

Camera = Callable[..., CameraProgram]

FAST = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


@pytest.fixture
def camera(processes: Processes) -> Camera:
    """Start an emulated camera that serves, on a free port or a given one: `camera("--plate", "60")`."""

    def start_camera(*arguments: str, port: int = 0) -> CameraProgram:
        server = CameraProgram(
            processes, "emulated", *arguments, listen=f"127.0.0.1:{port}"
        )
        assert server.port
        return server

    return start_camera


class Ears:
    """All that the bridge publishes."""

    def __init__(self, listener: Any) -> None:
        self._listener = listener
        self.temperatures: list[Temperature] = listener.hear(
            Temperature, "plant/temperature", FAST
        )
        self.spreads: list[Float64] = listener.hear(Float64, "plant/uniformity", FAST)
        self.raw: list[Image] = listener.hear(Image, "thermal/image_raw", FAST)
        self.degrees: list[Image] = listener.hear(Image, "thermal/image", FAST)
        assert not listener.health

    @property
    def health(self) -> list[Any]:
        """Reports of the bridge alone."""
        return self._listener.reports("camera_bridge: health")

    def until(self, condition: Callable[[], Any], what: str) -> None:
        self._listener.spin_until(condition, what)

    def go_on(self) -> None:
        """Until three more temperatures came."""
        count_before = len(self.temperatures)
        self.until(lambda: len(self.temperatures) >= count_before + 3, "temperatures")

    @property
    def warning(self) -> str:
        return self.health[-1].message if self.health else ""

    @property
    def level(self) -> bytes:
        return self.health[-1].level if self.health else b"\x03"

    @property
    def values(self) -> dict[str, str]:
        return {v.key: v.value for v in self.health[-1].values} if self.health else {}


@pytest.fixture
def ears(listener: Any) -> Ears:
    return Ears(listener)


def celsius_of(image: Image) -> Any:
    return np.frombuffer(bytes(image.data), "<f4").reshape(image.height, image.width)


def stamp_of(message: Any) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec / 1e9


def test_an_emulated_lepton_is_seen(
    start_process: Start, camera: Camera, ears: Ears
) -> None:
    bridge = start_process(
        "camera_bridge",
        "-p",
        f"port:={camera('--plate', '60').port}",
        "-p",
        "image_rate:=0.0",
    )
    ears.until(
        lambda: len(ears.temperatures) > 20 and ears.level == b"\x00",
        "temperatures and health",
    )
    newest = ears.temperatures[-1]
    # The plate's middle loses a thousandth of its excess over 23 °C; the noise all pixels share is 0.08 K.
    assert newest.temperature == pytest.approx(60.0, abs=0.6)
    # Noise of a pixel (0.05 K)², and the gradient over the region.
    assert 0.0015 < newest.variance < 0.01
    assert newest.header.frame_id == "plate"
    assert 0 < time.time() - stamp_of(newest) < 30
    stamps = [stamp_of(message) for message in ears.temperatures]
    gaps = np.diff(stamps)
    # the camera's own pace of 9 Hz; it makes up for what a busy machine delays
    assert np.median(gaps) > 0.05
    # The corners of the plate are 2 % of the excess colder, each pixel has its noise.
    assert 0.7 < ears.spreads[-1].data < 1.7
    raw = ears.raw[-1]
    degrees = ears.degrees[-1]
    assert (raw.encoding, degrees.encoding) == ("mono16", "32FC1")
    assert raw.header.frame_id == "thermal_camera"
    counts = np.frombuffer(bytes(raw.data), "<u2").reshape(60, 80)
    np.testing.assert_allclose(counts[0, 0] / 100 - 273.15, 23.0, atol=1.0)
    assert celsius_of(degrees)[29, 39] == pytest.approx(60.0, abs=1.0)
    values = ears.values
    assert values["link"] == "streaming"
    assert values["flat-field correction"] == "COMPLETE"
    assert values["reconnects"] == values["bad frames"] == "0"
    assert float(values["sensor temperature"].split()[0]) == pytest.approx(
        23.0, abs=3.0
    )
    assert sockets_elsewhere(bridge.id) == []
    assert bridge.well(bridge.end())


def test_a_closed_shutter_gives_no_temperature_and_no_degrees(
    start: Start, camera: Camera, ears: Ears
) -> None:
    """A correction every 4 s takes 0.9 s: eight frames that repeat the one before."""
    port = camera("--plate", "60", "--flat-field-period", "4").port
    start("camera_bridge", "-p", f"port:={port}", "-p", "image_rate:=0.0")
    ears.until(
        lambda: any(np.isnan(celsius_of(i)).all() for i in ears.degrees),
        "a closed shutter",
    )
    ears.until(lambda: len(ears.degrees) > 90, "two corrections")
    closed = {stamp_of(i) for i in ears.degrees if np.isnan(celsius_of(i)).all()}
    temperature_stamps = {stamp_of(message) for message in ears.temperatures}
    assert not closed & temperature_stamps
    assert closed <= {stamp_of(image) for image in ears.raw} | {max(closed)}
    first = min(temperature_stamps)
    last = max(temperature_stamps)
    assert any(first < stamp < last for stamp in closed)
    gaps = np.diff(sorted(temperature_stamps))
    assert gaps.max() > 0.8
    assert int(ears.values["repeated or frozen frames"]) >= 8


def test_a_camera_that_goes_and_comes_back(
    start: Start, camera: Camera, ears: Ears
) -> None:
    first = camera("--plate", "40")
    start("camera_bridge", "-p", f"port:={first.port}", "-p", "stale_after:=1.0")
    ears.go_on()
    first.process.kill()
    ears.until(
        lambda: (
            ears.level == b"\x02" and "is the camera server running" in ears.warning
        ),
        "the error",
    )
    ears.until(lambda: "no new image for" in ears.warning, "the age")
    silent = len(ears.temperatures)
    reports_before = len(ears.health)
    ears.until(lambda: len(ears.health) > reports_before + 1, "reports")
    assert len(ears.temperatures) == silent
    camera("--plate", "50", port=first.port)
    ears.until(
        lambda: ears.temperatures[-1].temperature == pytest.approx(50.0, abs=0.6),
        "the new one",
    )
    ears.until(lambda: ears.level == b"\x00", "health")
    assert ears.values["reconnects"] == ears.values["server restarts"] == "1"


def test_a_camera_that_hangs_is_given_up_and_never_seen_as_fresh(
    start: Start, camera: Camera, ears: Ears
) -> None:
    program = camera("--plate", "40")
    start("camera_bridge", "-p", f"port:={program.port}", "-p", "stall_timeout:=0.5")
    ears.go_on()
    program.process.freeze()
    ears.until(lambda: "no complete frame within" in ears.warning, "the stall")
    program.process.thaw()
    ears.go_on()
    ears.until(lambda: ears.level == b"\x00", "health")


def test_no_camera_at_the_start_is_waited_for(
    start: Start, camera: Camera, ears: Ears
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    start("camera_bridge", "-p", f"port:={port}")
    ears.until(lambda: ears.level == b"\x02", "the error")
    camera("--plate", "40", port=port)
    ears.go_on()


def test_an_image_too_small_for_the_region_is_shown_but_not_measured(
    start: Start, camera: Camera, ears: Ears
) -> None:
    start(
        "camera_bridge",
        "-p",
        f"port:={camera('--plate', '40').port}",
        "-p",
        "roi.x:=75",
    )
    ears.until(lambda: "leave the image of 60 by 80" in ears.warning, "the warning")
    assert int(ears.values["unusable frames"]) > 0
    ears.until(lambda: len(ears.raw) > 3, "images")
    assert not ears.temperatures


class Liar:
    """A server of good frames and, when asked, of noise."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.05)
        self.port = self._listener.getsockname()[1]
        self.lies = False
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        self._listener.close()

    def _run(self) -> None:
        lepton = EmulatedLepton(LeptonSettings(flat_field_period=1000.0))
        start = time.monotonic()
        number = 0
        while not self._ending.is_set():
            try:
                client = self._listener.accept()[0]
            except TimeoutError:
                continue
            with client, contextlib.suppress(OSError):  # until the other end has enough
                while not self._ending.wait(0.05):
                    elapsed = 10.0 + time.monotonic() - start
                    exposure = lepton.expose(40.0, elapsed, time.monotonic_ns())
                    data = encode_frame(exposure.numbered(number, b"0123456789abcdef"))
                    number += 1
                    client.sendall(b"\xff" * 500 if self.lies else data)


def test_bad_frames_are_counted_and_good_ones_taken_again(
    start: Start, ears: Ears
) -> None:
    liar = Liar()
    try:
        start("camera_bridge", "-p", f"port:={liar.port}")
        ears.go_on()
        liar.lies = True
        ears.until(
            lambda: ears.level == b"\x02" and int(ears.values["bad frames"]) > 1,
            "bad frames",
        )
        liar.lies = False
        ears.go_on()
        assert all(
            t.temperature == pytest.approx(40.0, abs=0.6) for t in ears.temperatures
        )
    finally:
        liar.close()


def test_rates_can_be_limited(start: Start, camera: Camera, ears: Ears) -> None:
    port = camera("--plate", "40").port
    start(
        "camera_bridge",
        "-p",
        f"port:={port}",
        "-p",
        "temperature_rate:=2.0",
        "-p",
        "image_rate:=1.0",
    )
    ears.until(
        lambda: len(ears.temperatures) >= 6 and len(ears.raw) >= 2, "some of each"
    )
    stamps = [stamp_of(message) for message in ears.temperatures]
    assert np.diff(stamps).min() > 0.4
    assert len(ears.raw) < len(ears.temperatures)


def test_stamps_are_of_the_simulated_clock(
    start: Start, camera: Camera, ears: Ears, listener: Any
) -> None:
    clock = listener.node.create_publisher(Clock, "/clock", 10)
    start(
        "camera_bridge",
        "-p",
        f"port:={camera('--plate', '40').port}",
        "-p",
        "use_sim_time:=true",
    )
    plant_time = Clock()
    plant_time.clock.sec = 1234

    def tick() -> bool:
        plant_time.clock.nanosec = min(
            plant_time.clock.nanosec + 1_000_000, 999_999_999
        )
        clock.publish(plant_time)
        return any(
            1233.0 < stamp_of(message) <= 1235.0 for message in ears.temperatures
        )

    ears.until(tick, "a stamp in simulated time")


def exposure(
    counts: list[list[int]], resolution: float = 0.01, **values: Any
) -> Exposure:
    image = np.array(counts, dtype=np.uint16)
    return Exposure(
        image=image, stamp=0, resolution=resolution, frame_counter=0, **values
    )


def test_centikelvin_are_the_counts_of_a_fine_camera() -> None:
    counts = [[0, 29815, 65535]]
    assert centikelvin(exposure(counts)).tolist() == counts


def test_a_coarse_camera_is_scaled_but_not_its_ends() -> None:
    """0 and 65535 mean no value, and no value becomes one of them."""
    scaled = centikelvin(exposure([[0, 2982, 6600, 65535]], resolution=0.1))
    assert scaled.tolist() == [[0, 29820, 65534, 65535]]


def test_raw_is_mono16_row_by_row() -> None:
    message = raw_image(exposure([[1, 2, 3], [4, 5, 65535]]), Header())
    assert (message.height, message.width, message.step, message.encoding) == (
        2,
        3,
        6,
        "mono16",
    )
    assert message.is_bigendian == 0
    assert np.frombuffer(bytes(message.data), "<u2").tolist() == [1, 2, 3, 4, 5, 65535]


def test_celsius_has_nan_where_there_is_no_value() -> None:
    message = celsius_image(exposure([[0, 29815], [27315, 65535]]), Header())
    assert (message.height, message.width, message.step, message.encoding) == (
        2,
        2,
        8,
        "32FC1",
    )
    degrees = np.frombuffer(bytes(message.data), "<f4")
    np.testing.assert_allclose(degrees, [np.nan, 25.0, 0.0, np.nan], atol=1e-5)


def test_a_closed_shutter_shows_nothing() -> None:
    closed = exposure([[29815, 29815]], flat_field=FlatField.RUNNING)
    assert np.isnan(
        np.frombuffer(bytes(celsius_image(closed, Header()).data), "<f4")
    ).all()


def test_a_picture_does_not_hold_temperatures() -> None:
    with pytest.raises(RegionError, match="counts are not temperatures"):
        celsius_image(exposure([[1, 2]], flags=FrameFlags.GAIN_CONTROL), Header())


SECOND = 1_000_000_000


def test_real_time_runs_as_the_wall_does() -> None:
    past = WallToRos()
    assert (
        past.at(7 * SECOND, wall=9 * SECOND, ros=1000 * SECOND, simulated=False)
        == 998 * SECOND
    )


@pytest.mark.parametrize("speed", [0.5, 1.0, 10.0])
def test_a_second_ago_is_many_in_a_fast_simulation(speed: float) -> None:
    past = WallToRos()
    for tick in range(100):
        wall = tick * SECOND // 10
        ros = 5000 * SECOND + round(wall * speed)
        stamp = past.at(wall - SECOND // 100, wall=wall, ros=ros, simulated=True)
    assert stamp == pytest.approx(ros - 0.01 * speed * SECOND, abs=1e-6 * SECOND)


def test_leaps_of_the_clock_do_not_count_as_pace() -> None:
    past = WallToRos()
    for wall, ros in ((0, 0), (1, 1), (2, 1_000_000), (3, 5)):
        past.at(0, wall=wall * SECOND, ros=ros * SECOND, simulated=True)
    assert (
        past.at(3 * SECOND, wall=4 * SECOND, ros=6 * SECOND, simulated=True)
        == 5 * SECOND
    )


def test_before_the_clock_is_set_there_is_no_past() -> None:
    past = WallToRos()
    assert past.at(7 * SECOND, wall=9 * SECOND, ros=0, simulated=True) == 0
