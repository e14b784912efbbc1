"""Brings the thermal stream into the ROS graph: images, and the temperature of the plate."""

from __future__ import annotations

import time
from array import array
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, Temperature
from std_msgs.msg import Float64, Header

from twinmatch.links import Background
from twinmatch.links.thermal_client import (
    COUNT_ENDS,
    ClientSettings,
    LinkState,
    Received,
    Region,
    RegionError,
    ThermalClient,
    celsius,
    region,
)
from twinmatch.links.thermal_frame import DEFAULT_PORT, Exposure, ThermalFrame
from twinmatch.nodes.expected import CLOCK_STRIDE
from twinmatch.nodes.health import Level, Report
from twinmatch.nodes.messages import time_message
from twinmatch.nodes.node import TwinmatchNode
from twinmatch.parameters.declared import Setting, given_to, parameters_of
from twinmatch.signals import KELVIN

SMOOTHING = 0.2
"""Weight of the newest reading in the estimate of the clock's speed."""


class WallToRos:
    """Estimates the speed of the ROS clock from its readings; real time has speed 1."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None
        self._pace = 1.0

    def at(self, image_time: int, *, wall: int, ros: int, simulated: bool) -> int:
        """The ROS time of a monotonic `image_time`, given current readings of both clocks; all in ns."""
        if not simulated:
            return ros - (wall - image_time)
        if self._last is not None and wall > self._last[0]:
            pace = (ros - self._last[1]) / (wall - self._last[0])
            if 0.0 <= pace <= CLOCK_STRIDE.fastest:
                self._pace += SMOOTHING * (pace - self._pace)
        self._last = (wall, ros)
        # a clock that is not set yet reads 0
        return max(0, ros - round((wall - image_time) * self._pace))


CENTIKELVIN = 0.01
"""Resolution of the published images, K."""


def centikelvin(exposure: Exposure) -> NDArray[np.uint16]:
    """The image in hundredths of a kelvin at any camera resolution; 0 and 65535 still mean no value."""
    counts = exposure.image
    if exposure.resolution == CENTIKELVIN:
        return counts
    scaled = np.rint(counts * (exposure.resolution / CENTIKELVIN))
    scaled = np.clip(scaled, COUNT_ENDS.lowest + 1, COUNT_ENDS.highest - 1)
    return np.where(COUNT_ENDS.include(counts), counts, scaled).astype(np.uint16)


def raw_image(exposure: Exposure, header: Header) -> Image:
    """The image as mono16 in centikelvin."""
    return _image("mono16", centikelvin(exposure).astype("<u2"), header)


def celsius_image(exposure: Exposure, header: Header) -> Image:
    """The image as 32FC1 in °C; NaN means no value, which is everywhere while the shutter is closed.

    Raises:
        RegionError: the camera's counts are not temperatures.
    """
    degrees = celsius(exposure)
    if exposure.frozen:
        degrees = np.full_like(degrees, np.nan)
    return _image("32FC1", degrees.astype("<f4"), header)


def _image(encoding: str, pixels: NDArray[Any], header: Header) -> Image:
    rows, columns = pixels.shape
    message = Image(
        height=rows,
        width=columns,
        encoding=encoding,
        step=columns * pixels.itemsize,
        header=header,
    )
    # the field's own type: not checked item by item
    message.data = array("B", pixels.tobytes())
    return message


_IMAGE_RATE = "Highest rate of images, by the wall clock; 0: all."
_TEMPERATURE_RATE = "Highest rate of temperatures; 0: every new image."
PATIENCE = 0.2
"""Longest wait of the thread for a frame before it checks whether it should end, s."""

SAME_CLOCK = 60_000_000_000
"""Stamps of a simulated camera within this of simulated time are taken to be on that clock, ns."""


def _region_parameters(
    name: str, text: str, usual: tuple[int, int, int, int]
) -> tuple[Setting, ...]:
    x, y, width, height = usual
    first_row = "First row, 0 at the top." if name == "roi" else "First row."
    return (
        Setting(f"{name}.x", x, text, "pixels", 0, 1023),
        Setting(f"{name}.y", y, first_row, "pixels", 0, 1023),
        Setting(f"{name}.width", width, "Columns.", "pixels", 1, 1024),
        Setting(f"{name}.height", height, "Rows.", "pixels", 1, 1024),
    )


class CameraBridge(TwinmatchNode):
    """Publishes the newest frame of a camera server, and the temperature of the plate in it.

    A temperature is published only with a new image, not while the shutter is closed or the camera repeats
    an image, so that its age can be trusted. While the shutter is closed, `thermal/image` is all NaN.
    """

    NAME = "camera_bridge"
    PARAMETERS: ClassVar = (
        Setting("host", "127.0.0.1", "Computer on which the camera server runs."),
        Setting("port", DEFAULT_PORT, "Its TCP port.", "", 1, 65535),
        *parameters_of(ClientSettings()),
        Setting(
            "stale_after",
            3.0,
            "Age of the newest image that is an error.",
            "s",
            0.1,
            60.0,
        ),
        *_region_parameters(
            "roi",
            "Region whose mean is the temperature: first column.",
            (34, 24, 12, 12),
        ),
        *_region_parameters(
            "plate",
            "Region of the whole plate, for its uniformity: first column.",
            (22, 14, 36, 32),
        ),
        Setting("temperature_rate", 0.0, _TEMPERATURE_RATE, "Hz", 0.0, 1000.0),
        Setting("image_rate", 10.0, _IMAGE_RATE, "Hz", 0.0, 1000.0),
        Setting("frame_id", "thermal_camera", "Frame of the images."),
        Setting("plate_frame_id", "plate", "Frame of the temperature."),
    )

    def read_parameters(self) -> None:
        """Derive the regions and the settings of the link."""
        values = self.values
        self._roi = _region_from(values, "roi")
        self._plate = _region_from(values, "plate")
        self._temperature_gap = (
            1e9 / values["temperature_rate"] if values["temperature_rate"] else 0.0
        )
        self._image_gap = 1e9 / values["image_rate"] if values["image_rate"] else 0.0
        self._camera = ThermalClient(
            values["host"], values["port"], given_to(ClientSettings(), values)
        )
        self._wall_to_ros = WallToRos()
        self._thread = Background("camera", self._run)
        self.beside += [self._thread, self._camera]
        self._measured_at: int | None = None  # stamp of the last temperature, ns
        # when the last images were published, monotonic ns
        self._pictured_at: int | None = None
        # frames at the last report, and when that was
        self._counted = (0, time.monotonic())

    def open(self) -> None:
        """Connect, with retries."""
        self._raw = self.create_publisher(
            Image, "thermal/image_raw", qos_profile_sensor_data
        )
        self._degrees = self.create_publisher(
            Image, "thermal/image", qos_profile_sensor_data
        )
        self._temperature = self.create_publisher(
            Temperature, "plant/temperature", qos_profile_sensor_data
        )
        self._uniformity = self.create_publisher(
            Float64, "plant/uniformity", qos_profile_sensor_data
        )
        self.health.say("streaming")
        self.report_on()
        self._camera.start()
        self._thread.start()

    def report(self) -> Report:
        """State of the link, pace and age of the images, state of the camera."""
        health = self.health
        status = self._camera.status
        frames = status.frames
        wall_now = time.monotonic()
        rate = (frames - self._counted[0]) / (wall_now - self._counted[1])
        self._counted = (frames, wall_now)
        errors = status.errors
        frame_errors = [errors[name] for name in errors if name.startswith("Frame")]
        shown_values = {
            "link": status.state.value,
            "frame rate": f"{rate:.1f} Hz",
            "frames": frames,
            "repeated or frozen frames": status.frozen,
            "missed frames": status.missed,
            "reconnects": max(0, status.connections - 1),
            "server restarts": status.restarts,
            **errors,
            "bad frames": sum(frame_errors),
        }
        for name, value in shown_values.items():
            health.set(name, value)
        down = status.state is not LinkState.STREAMING or not frames
        health.flag_if(
            down,
            "link",
            Level.ERROR,
            str(status.last_error or "thermal camera: connecting"),
        )
        self._report_age()
        return super().report()

    def _report_age(self) -> None:
        health = self.health
        newest = self._camera.newest()
        news = self._camera.news()
        if newest is not None:
            frame = newest.frame
            state = "unknown" if frame.flat_field is None else frame.flat_field.name
            health.set("flat-field correction", state)
            if frame.sensor_temperature is not None:
                health.set(
                    "sensor temperature",
                    f"{frame.sensor_temperature / 100 - KELVIN:.1f} °C",
                )
        if news is None:
            return
        age = (time.monotonic_ns() - news.received) / 1e9
        health.set("age of the newest image", f"{age:.2f} s")
        stuck = f"no new image for {age:.0f} s; is the shutter stuck?"
        health.flag_if(age > self.values["stale_after"], "age", Level.ERROR, stuck)

    def _run(self) -> None:
        number = 0
        while not self._thread.ending.is_set():
            received = self._camera.wait(number, PATIENCE)
            if received is not None:
                number = received.number
                self._take(received)
                if self.step is not None:
                    self.step.image(received.frame.stamp)

    def _take(self, received: Received) -> None:
        frame = received.frame
        if not (received.news or frame.frozen):
            return  # the camera is polled more often than it has a new image
        stamp = self._stamp(received)
        try:
            self._publish_images(frame, stamp)
            if received.news:
                self._publish_temperature(frame, stamp)
        except RegionError as error:
            self.health.count("unusable frames")
            self.health.flag("frame", Level.ERROR, str(error))
        else:
            self.health.withdraw("frame")

    def _stamp(self, received: Received) -> int:
        """When the image was taken, on the ROS clock, ns."""
        clock = self.get_clock()
        ros = clock.now().nanoseconds
        wall = time.monotonic_ns()
        if clock.ros_time_is_active and abs(ros - received.frame.stamp) < SAME_CLOCK:
            return received.frame.stamp  # a simulated camera stamps in simulated time
        return self._wall_to_ros.at(
            received.taken, wall=wall, ros=ros, simulated=clock.ros_time_is_active
        )

    def _publish_temperature(self, frame: ThermalFrame, stamp: int) -> None:
        last = self._measured_at
        if last is not None and 0 <= stamp - last < self._temperature_gap:
            return
        self._measured_at = stamp
        roi = region(frame, self._roi)
        plate = region(frame, self._plate)
        header = Header(
            frame_id=self.values["plate_frame_id"], stamp=time_message(stamp)
        )
        self._temperature.publish(
            Temperature(header=header, temperature=roi.mean, variance=roi.variance)
        )
        self._uniformity.publish(Float64(data=plate.spread))
        self.health.set("temperature", f"{roi.mean:.2f} °C")
        self.health.set("spread over the plate", f"{plate.spread:.2f} °C")

    def _publish_images(self, frame: ThermalFrame, stamp: int) -> None:
        wall_now = time.monotonic_ns()
        if (
            self._pictured_at is not None
            and wall_now - self._pictured_at < self._image_gap
        ):
            return
        self._pictured_at = wall_now
        header = Header(frame_id=self.values["frame_id"], stamp=time_message(stamp))
        # first, as it refuses counts that are not temperatures
        degrees = celsius_image(frame, header)
        self._raw.publish(raw_image(frame, header))
        self._degrees.publish(degrees)


def _region_from(values: dict[str, Any], name: str) -> Region:
    column = values[f"{name}.x"]
    row = values[f"{name}.y"]
    return Region(
        row=row,
        column=column,
        rows=values[f"{name}.height"],
        columns=values[f"{name}.width"],
    )
