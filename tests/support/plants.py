"""Plants for tests."""

from __future__ import annotations

from twinmatch.dynamics import (
    DeadTime,
    Disturbance,
    Drive,
    Equations,
    Output,
    Parameter,
    PidGains,
    Plant,
    State,
    Structure,
    limited,
    magnitude,
)


class Lag(Plant, name="lag"):
    """dx/dt = (gain·u − x)/lag."""

    y = Output(unit="m", noise=0.01, span=(-100.0, 100.0))
    u = Drive(unit="V", limits=(-10.0, 10.0), noise=0.1)
    x = State(unit="m", span=(-50.0, 50.0))
    gain = Parameter(unit="m/V", default=2.0, bounds=(0.1, 10.0), positive=True)
    lag = Parameter(unit="s", default=5.0, bounds=(0.5, 50.0), positive=True)
    structures = {"lag": Structure(free=("gain", "lag"))}  # noqa: RUF012

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """One line."""
        return Equations(
            rates={self.x: (self.gain * self.u - self.x) / self.lag},
            output=self.x,
            start={self.x: self.y},
        )


class Motor(Plant, name="motor"):
    """A DC motor that holds a speed against a load: current limit, dry friction, and an inertia."""

    title = "DC motor"
    followed = "with friction"
    parts = ("friction",)
    speed = Output(unit="rad/s", noise=0.2, span=(-500.0, 500.0))
    volts = Drive(unit="V", limits=(-24.0, 24.0), noise=0.3)
    load = Disturbance(unit="N m", default=0.0)
    omega = State(unit="rad/s", span=(-400.0, 400.0), scale=20.0)
    k = Parameter(
        unit="V s/rad",
        default=0.05,
        bounds=(0.005, 0.5),
        positive=True,
        text="torque constant",
    )
    r = Parameter(
        unit="Ω", default=1.2, bounds=(0.2, 10.0), positive=True, text="resistance"
    )
    j = Parameter(
        unit="kg m²", default=4e-4, bounds=(2e-5, 1e-2), positive=True, text="inertia"
    )
    b = Parameter(
        unit="N m s/rad",
        default=1e-4,
        bounds=(0.0, 1e-2),
        least=0.0,
        text="viscous friction",
    )
    dry = Parameter(
        unit="N m", default=0.01, bounds=(0.0, 0.1), least=0.0, text="dry friction"
    )
    most = Parameter(
        unit="A", default=8.0, bounds=(1.0, 50.0), positive=True, text="current limit"
    )
    structures = {  # noqa: RUF012
        "without friction": Structure(free=("k", "j", "b")),
        "with friction": Structure(
            free=("k", "j", "b", "dry"), parts=frozenset({"friction"})
        ),
    }
    loop = PidGains(0.15, 0.6, 0.0, 5.0, -24.0, 24.0, period=0.05)

    def equations(self, parts: frozenset[str]) -> Equations:
        """Electrical side quasi-static; dry friction fades in over 20 rad/s."""
        current = limited(
            (self.volts - self.k * self.omega) / self.r, -self.most, self.most
        )
        torque = self.k * current - self.b * self.omega - self.load
        if "friction" in parts:
            torque -= self.dry * self.omega / (20 + magnitude(self.omega))
        return Equations(
            rates={self.omega: torque / self.j},
            output=self.omega,
            start={self.omega: self.speed},
            quantities={"current": current},
        )


class Tank(Plant, name="tank"):
    """A tank that runs out through a hole, whose outflow is measured: an output bent and with a parameter."""

    outflow = Output(unit="l/s", noise=0.005, span=(0.05, 5.0))
    inflow = Drive(unit="l/s", limits=(0.0, 4.0), noise=0.05)
    level = State(unit="dm", span=(0.1, 10.0))
    area = Parameter(unit="dm²", default=6.0, bounds=(1.0, 30.0), positive=True)
    hole = Parameter(unit="l/s/√dm", default=0.8, bounds=(0.1, 3.0), positive=True)
    structures = {"open": Structure(free=("area", "hole"))}  # noqa: RUF012
    loop = PidGains(1.5, 0.15, 0.0, 1.0, 0.0, 4.0)

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Torricelli's law."""
        import sympy

        leaving = self.hole * sympy.sqrt(self.level)
        return Equations(
            rates={self.level: (self.inflow - leaving) / self.area},
            output=leaving,
            start={self.level: (self.outflow / self.hole) ** 2},
        )


class Box(Plant, name="box"):
    """Air warmed by a bed that no sensor shows, in a room whose temperature is measured; no loop is known."""

    # as the incubator, whose windows and horizons it is judged by
    time_constant = 100.0
    temperature = Output(
        unit="°C", noise=0.05, span=(0.0, 80.0), set_points=(20.0, 50.0)
    )
    heater = Drive(unit="", limits=(0.0, 1.0), noise=0.05)
    room = Disturbance(unit="°C", default=21.0, text="room")
    air = State(unit="°C", span=(0.0, 80.0))
    bed = State(unit="°C", span=(0.0, 150.0))
    power = Parameter(unit="W", default=100.0, bounds=(20.0, 500.0), positive=True)
    air_capacity = Parameter(
        unit="J/K", default=500.0, bounds=(50.0, 5000.0), positive=True
    )
    bed_capacity = Parameter(
        unit="J/K", default=300.0, bounds=(30.0, 3000.0), positive=True
    )
    bed_conductance = Parameter(
        unit="W/K", default=1.5, bounds=(0.1, 20.0), positive=True
    )
    box_conductance = Parameter(
        unit="W/K", default=0.8, bounds=(0.05, 10.0), positive=True
    )
    structures = {  # noqa: RUF012
        "box": Structure(
            free=("air_capacity", "bed_conductance", "box_conductance"),
            free_starts=("bed",),
        )
    }

    def equations(self, parts: frozenset[str]) -> Equations:  # noqa: ARG002
        """Heat goes from the bed to the air and from there to the room."""
        from_bed = self.bed_conductance * (self.bed - self.air)
        lost = self.box_conductance * (self.air - self.room)
        return Equations(
            rates={
                self.air: (from_bed - lost) / self.air_capacity,
                self.bed: (self.power * self.heater - from_bed) / self.bed_capacity,
            },
            output=self.air,
            start={self.air: self.temperature, self.bed: self.temperature},
        )


class Exchanger(Plant, name="exchanger"):
    """A heat exchanger at the end of a pipe that the heated liquid has to pass first."""

    parts = ("pipe",)
    temperature = Output(unit="°C", noise=0.1, span=(0.0, 150.0))
    heater = Drive(unit="%", limits=(0.0, 100.0), noise=0.5)
    inlet = Disturbance(unit="°C", default=20.0)
    outlet = State(unit="°C", span=(0.0, 150.0))
    pipe = DeadTime(unit="%", span=(0.0, 100.0), text="heat on its way")
    gain = Parameter(unit="K/%", default=1.0, bounds=(0.05, 5.0), positive=True)
    lag = Parameter(unit="s", default=20.0, bounds=(2.0, 300.0), positive=True)
    delay = Parameter(unit="s", default=5.0, bounds=(2.0, 60.0), positive=True)
    structures = {  # noqa: RUF012
        "with pipe": Structure(
            free=("gain", "lag", "delay"), parts=frozenset({"pipe"})
        ),
        "without": Structure(free=("gain", "lag")),
    }
    loop = PidGains(0.6, 0.03, 0.0, 0.1, 0.0, 100.0)

    def equations(self, parts: frozenset[str]) -> Equations:
        """What heats now left the heater some time ago."""
        came = self.pipe.after(self.heater, self.delay)
        rates, start = (came.rates, came.start) if "pipe" in parts else ({}, {})
        power = came.value if "pipe" in parts else self.heater
        return Equations(
            rates={
                self.outlet: (self.inlet + self.gain * power - self.outlet) / self.lag,
                **rates,
            },
            output=self.outlet,
            start={self.outlet: self.temperature, **start},
        )
